"""Both detectors: one contract, and that each learns to find what it is shown."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from posenet.detectors import heatmap as heatmap_detector
from posenet.detectors import rpn as rpn_detector
from posenet.detectors.base import Detections, Detector
from posenet.detectors.heatmap import HEATMAP_LIMITS, HeatmapDetector
from posenet.detectors.rpn import NEGATIVE, NEUTRAL, POSITIVE, RPN_LIMITS, RpnDetector
from posenet.layers import ops
from posenet.layers.mean import Mean
from posenet.network.backbone import build_backbone

HEIGHT, WIDTH = 96, 128
KINDS = ["heatmap", "rpn"]
NONE = torch.zeros(0, 4)


@pytest.fixture(autouse=True)
def _one_thread() -> object:
    """Networks this small are slower on two threads, and far slower where the machine is shared."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def detector(kind: str, channels: int = 64, stride: int = 8) -> Detector:
    if kind == "heatmap":
        return HeatmapDetector(channels, stride, object_size=26.0, limits=replace(HEATMAP_LIMITS, least=20))
    limits = replace(RPN_LIMITS, least=20)
    sizes = (20.0, 28.0)
    return RpnDetector(
        channels, stride, sizes, hidden=64, fc_width=128, rois_per_image=64, candidates=500, limits=limits
    )


def losses_of(head: Detector, raw: object, boxes: list[Tensor], ignore: list[Tensor]) -> dict[str, Tensor]:
    """The means, with the same draws each time."""
    draws = [torch.Generator().manual_seed(n) for n in range(len(boxes))]
    found = head.losses(raw, boxes, ignore, draws)
    assert all(isinstance(part, Mean) for part in found.values())
    return {name: part.value for name, part in found.items()}


def rectangles(generator: torch.Generator, count: int) -> tuple[Tensor, Tensor]:
    """An image (3, H, W) of `count` rectangles, some before others, and their boxes (n, 4)."""
    image, boxes = torch.zeros(3, HEIGHT, WIDTH), NONE
    while len(boxes) < count:
        w, h = torch.randint(18, 34, (2,), generator=generator).tolist()
        x, y = (int(torch.randint(0, room, (), generator=generator)) for room in (WIDTH - w, HEIGHT - h))
        box = torch.tensor([[x, y, x + w, y + h]]).float()
        if len(boxes) and ops.box_iou(box, boxes).max() > 0.2:
            continue
        image[0, y : y + h, x : x + w] = 0.3 + 0.7 * float(torch.rand((), generator=generator))
        image[1, y : y + h, x : x + w] = torch.linspace(-1, 1, w)
        image[2, y : y + h, x : x + w] = torch.linspace(-1, 1, h)[:, None]
        boxes = torch.cat([boxes, box])
    return image, boxes


def recall_and_precision(found: list[Detections], truth: list[Tensor]) -> tuple[float, float]:
    hits = total = claimed = 0
    for detections, boxes in zip(found, truth, strict=True):
        sure = detections.boxes[detections.scores > 0.5]
        overlap = ops.box_iou(boxes, sure)
        hits += int((overlap > 0.7).any(1).sum())
        total, claimed = total + len(boxes), claimed + len(sure)
    return hits / total, hits / max(claimed, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_detector_learns_to_find_rectangles_and_to_leave_an_empty_image_empty(kind: str) -> None:
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    images, boxes = zip(*(rectangles(generator, count) for count in (6, 5, 3, 0)), strict=True)
    batch, truth, ignore = torch.stack(images), list(boxes), [NONE] * 4
    trunk = build_backbone("vgg_debug", 3)
    head = detector(kind)
    parameters = [*trunk.parameters(), *head.parameters()]
    steps = 120  # with 80 it depends on the CPU whether one false box is left
    optimizer = torch.optim.AdamW(parameters)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps)
    for _ in range(steps):
        loss = torch.stack(list(losses_of(head, head(trunk(batch), (HEIGHT, WIDTH)), truth, ignore).values())).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    trunk.eval(), head.eval()
    with torch.no_grad():
        found = head.detect(head(trunk(batch), (HEIGHT, WIDTH)))
    recall, precision = recall_and_precision(found, truth)
    assert recall >= 0.95
    assert precision >= 0.95
    assert not (found[3].scores > 0.2).any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [0, 3])
def test_losses_are_finite_and_reach_every_parameter(kind: str, count: int) -> None:
    torch.manual_seed(0)
    head = detector(kind)
    features = torch.randn(2, 64, 12, 16, requires_grad=True)
    boxes = [rectangles(torch.Generator().manual_seed(n), count)[1] for n in range(2)]
    losses = losses_of(head, head(features, (HEIGHT, WIDTH)), boxes, [NONE, NONE])
    torch.stack(list(losses.values())).sum().backward()
    assert all(loss.ndim == 0 and torch.isfinite(loss) and loss >= 0 for loss in losses.values())
    missing = [name for name, p in head.named_parameters() if p.grad is None or not torch.isfinite(p.grad).all()]
    assert missing == []
    assert features.grad is not None


@pytest.mark.parametrize("kind", KINDS)
def test_detections_are_sorted_bounded_and_inside_the_image(kind: str) -> None:
    torch.manual_seed(0)
    head = detector(kind).eval()
    with torch.no_grad():
        for parameter in head.parameters():
            parameter.mul_(3)  # wilder than an untrained one: boxes that leave the image, many of them
    raw = head(torch.randn(3, 64, 12, 16) * 5, (HEIGHT, WIDTH))
    for boxes, scores in head.detect(raw):
        assert 0 < len(boxes) <= 20
        assert scores.shape == (len(boxes),)
        assert not scores.requires_grad and not boxes.requires_grad
        assert (scores[:-1] >= scores[1:]).all()
        assert ((scores >= 0) & (scores <= 1)).all()
        assert ((boxes >= 0) & (boxes <= torch.tensor([WIDTH, HEIGHT, WIDTH, HEIGHT]))).all()
        assert (boxes[:, 2:] > boxes[:, :2]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_losses_and_detections(kind: str) -> None:
    def once() -> tuple[list[float], list[Tensor]]:
        torch.manual_seed(5)
        head = detector(kind)
        boxes = [rectangles(torch.Generator().manual_seed(1), 4)[1]]
        raw = head(torch.randn(1, 64, 12, 16), (HEIGHT, WIDTH))
        losses = [float(loss.detach()) for loss in losses_of(head, raw, boxes, [NONE]).values()]
        return losses, [part for found in head.detect(raw) for part in found]

    (losses, found), (losses_again, found_again) = once(), once()
    assert losses == losses_again
    assert all(torch.equal(a, b) for a, b in zip(found, found_again, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_losses_do_not_depend_on_the_order_of_the_boxes(kind: str) -> None:
    torch.manual_seed(0)
    head = detector(kind)
    boxes = rectangles(torch.Generator().manual_seed(1), 5)[1]
    raw = head(torch.randn(1, 64, 12, 16), (HEIGHT, WIDTH))
    losses = []
    for order in (torch.arange(5), torch.tensor([3, 1, 4, 0, 2])):
        torch.manual_seed(1)
        losses.append(torch.stack(list(losses_of(head, raw, [boxes[order]], [NONE]).values())))
    tolerance = 1e-5 if kind == "heatmap" else 0.2  # the second stage samples its regions at random
    torch.testing.assert_close(losses[0], losses[1], atol=tolerance, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_detectors_run_in_bfloat16_and_channels_last(kind: str) -> None:
    torch.manual_seed(0)
    head = detector(kind).to(memory_format=torch.channels_last)
    features = torch.randn(2, 64, 12, 16).contiguous(memory_format=torch.channels_last)
    boxes = [rectangles(torch.Generator().manual_seed(1), 3)[1]] * 2
    with torch.autocast("cpu", dtype=torch.bfloat16):
        raw = head(features, (HEIGHT, WIDTH))
        losses = losses_of(head, raw, boxes, [NONE, NONE])
        found = head.detect(raw)
    torch.stack(list(losses.values())).sum().backward()
    assert all(loss.dtype == torch.float32 for loss in losses.values())
    assert found[0].boxes.dtype == torch.float32


# The heatmap detector


def truth_as_output(boxes: Tensor, size: tuple[int, int], stride: int) -> heatmap_detector.HeatmapOutputs:
    """What a perfect heatmap detector would put out for boxes (n, 4) on a grid of `size`."""
    targets = heatmap_detector.center_targets(boxes, NONE, size, stride)
    probability = torch.where(targets.center, torch.tensor(0.999), 0.5 * targets.bell).clamp(1e-4, 0.999)
    learned = boxes[targets.box] if len(boxes) else torch.zeros(*size, 4)
    image = (size[0] * stride, size[1] * stride)
    return heatmap_detector.HeatmapOutputs(probability.logit()[None], learned[None], image)


@pytest.mark.parametrize("seed", range(10))
def test_heatmap_targets_decode_to_the_boxes_that_made_them(seed: int) -> None:
    boxes = rectangles(torch.Generator().manual_seed(seed), 6)[1]
    found = detector("heatmap").detect(truth_as_output(boxes, (12, 16), 8))[0]
    sure = found.boxes[found.scores > 0.9]
    assert sorted(map(tuple, sure.tolist())) == sorted(map(tuple, boxes.tolist()))


def test_neighbors_in_adjacent_cells_are_told_apart() -> None:
    boxes = torch.tensor([[20.0, 20, 60, 50], [30, 28, 64, 66]])  # centers (40, 35) and (47, 47): cells (5, 4), (5, 5)
    assert ops.box_iou(boxes, boxes)[0, 1] < 0.6
    raw = truth_as_output(boxes, (12, 16), 8)
    raw.logits[0, 5, 5] -= 2  # the one behind is less sure, so it is no local maximum
    found = detector("heatmap").detect(raw)[0]
    assert found.boxes[:2].tolist() == boxes.tolist()


def test_a_bell_is_one_at_a_center_and_falls_off() -> None:
    targets = heatmap_detector.center_targets(torch.tensor([[16.0, 24, 80, 88]]), NONE, (12, 16), 8)
    assert targets.center.nonzero().tolist() == [[7, 6]]
    along = targets.bell[7, 6:]
    assert along[0] == 1
    assert (along[:-1] > along[1:]).all() or along[-1] < 1e-6
    assert targets.learns_box.sum() == 9


def test_of_two_boxes_with_one_center_the_smaller_is_learned() -> None:
    small, large = torch.tensor([40.0, 40, 56, 56]), torch.tensor([20.0, 20, 76, 76])
    for boxes in (torch.stack([small, large]), torch.stack([large, small])):
        targets = heatmap_detector.center_targets(boxes, NONE, (12, 16), 8)
        assert torch.equal(boxes[targets.box[6, 6]], small)


def test_an_ignored_box_silences_the_negatives_at_its_center_and_is_no_positive() -> None:
    ignored = torch.tensor([[40.0, 40, 56, 56]])
    targets = heatmap_detector.center_targets(NONE, ignored, (12, 16), 8)
    assert not targets.center.any() and not targets.learns_box.any()
    surely_there = torch.full((1, 12, 16), -10.0)
    surely_there[0, 6, 6] = 10.0
    with_ignore = heatmap_detector.focal_loss(surely_there, targets.bell[None], targets.center[None]).value
    without = heatmap_detector.focal_loss(surely_there, torch.zeros(1, 12, 16), targets.center[None]).value
    assert with_ignore < 1e-3
    assert without > 5


def test_a_box_whose_center_lies_beyond_the_grid_is_learned_at_its_edge() -> None:
    targets = heatmap_detector.center_targets(torch.tensor([[100.0, -60, 180, -10]]), NONE, (12, 16), 8)
    assert targets.center.nonzero().tolist() == [[0, 15]]


def test_an_untrained_heatmap_starts_at_the_prior() -> None:
    torch.manual_seed(0)
    with torch.no_grad():
        raw = detector("heatmap")(torch.randn(1, 64, 12, 16), (HEIGHT, WIDTH))
    assert float(raw.logits.sigmoid().mean()) == pytest.approx(heatmap_detector.PRIOR, rel=0.3)
    assert float((raw.boxes[..., 2:] - raw.boxes[..., :2]).mean()) == pytest.approx(26.0, rel=0.2)


# The region proposal network


def test_anchors_have_the_stated_areas_and_ratios_at_the_cells_centers() -> None:
    shapes = rpn_detector.anchor_shapes((32.0, 64.0), (0.5, 1.0, 2.0))
    centers = heatmap_detector.cell_centers(3, 4, 16, torch.device("cpu"))
    anchors = rpn_detector.anchors_at(centers, shapes).view(3, 4, 6, 4)
    size = anchors[..., 2:] - anchors[..., :2]
    torch.testing.assert_close(size.prod(-1).sqrt(), torch.tensor([32.0] * 3 + [64.0] * 3).expand(3, 4, 6))
    torch.testing.assert_close(size[..., 1] / size[..., 0], torch.tensor([0.5, 1, 2] * 2).expand(3, 4, 6))
    middle = (anchors[1, 2, :, :2] + anchors[1, 2, :, 2:]) / 2
    torch.testing.assert_close(middle, torch.tensor([[40.0, 24.0]]).expand(6, 2))


def test_anchor_labels_follow_the_definition() -> None:
    anchors = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 8], [0, 0, 10, 5], [50, 50, 60, 60], [90, 90, 99, 99]])
    boxes = torch.tensor([[0.0, 0, 10, 10], [50, 50, 80, 80]])
    ignored = torch.tensor([[90.0, 90, 99, 98]])
    labels, match = rpn_detector.label_anchors(anchors, boxes, ignored)
    # IoU 1; 0.8; 0.5, in between; 0.11 but the best of the second box; over an ignored box.
    assert labels.tolist() == [POSITIVE, POSITIVE, NEUTRAL, POSITIVE, NEUTRAL]
    assert match.tolist()[:4] == [0, 0, 0, 1]


def test_region_labels_follow_the_definition() -> None:
    rois = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 5.1], [0, 0, 10, 3], [50, 50, 60, 60], [20, 20, 30, 30]])
    labels, match, hard = rpn_detector.label_rois(rois, rois[:1], rois[4:])
    assert labels.tolist() == [POSITIVE, POSITIVE, NEGATIVE, NEGATIVE, NEUTRAL]
    assert hard.tolist() == [False, False, True, False, False]
    assert match[:2].tolist() == [0, 0]


def test_without_boxes_every_candidate_is_negative() -> None:
    candidates = torch.rand(7, 2).repeat(1, 2) + torch.tensor([0.0, 0, 1, 1])
    assert (rpn_detector.label_anchors(candidates, NONE, NONE)[0] == NEGATIVE).all()
    assert (rpn_detector.label_rois(candidates, NONE, NONE)[0] == NEGATIVE).all()


def test_a_sample_takes_its_share_of_positives_then_the_preferred_negatives() -> None:
    draw = torch.Generator().manual_seed(0)
    labels = torch.tensor([POSITIVE] * 40 + [NEGATIVE] * 100 + [NEUTRAL] * 100)
    preferred = torch.zeros(240, dtype=torch.bool)
    preferred[40:60] = True
    chosen = rpn_detector.sample(labels, 64, 0.25, draw, preferred)
    assert len(chosen) == len(set(chosen.tolist())) == 64
    assert (labels[chosen] == POSITIVE).sum() == 16
    assert (labels[chosen] == NEGATIVE).sum() == 48
    assert set(range(40, 60)) <= set(chosen.tolist())
    assert len(rpn_detector.sample(labels[140:], 64, 0.5, draw)) == 0


def test_perfect_deltas_propose_the_boxes_themselves() -> None:
    head = detector("rpn")
    boxes = rectangles(torch.Generator().manual_seed(0), 5)[1]
    raw = head(torch.zeros(1, 64, 12, 16), (HEIGHT, WIDTH))
    labels, match = rpn_detector.label_anchors(raw.anchors, boxes, NONE)
    deltas = ops.encode_boxes(boxes[match], raw.anchors)[None]
    logits = torch.where(labels == POSITIVE, 5.0, -math.inf)[None]
    proposals = head.propose(raw._replace(logits=logits, deltas=deltas))[0]
    overlap = ops.box_iou(boxes, proposals[: len(boxes)])
    torch.testing.assert_close(overlap.amax(1), torch.ones(5))


def test_crossing_parts_whose_boxes_overlap_are_two_detections_and_one_part_seen_twice_is_one() -> None:
    head = HeatmapDetector(64, 8, object_size=26.0)
    logits = torch.full((1, 4, 8), -9.0)
    boxes = torch.zeros(1, 4, 8, 4)
    for cell, box in enumerate([[0, 0, 60, 60], [2, 0, 62, 60], [13, 5, 67, 63]]):  # IoU 0.94 and 0.63 with the first
        logits[0, 0, cell], boxes[0, 0, cell] = 3.0 - cell, torch.tensor(box).float()
    (found,) = head.detect(heatmap_detector.HeatmapOutputs(logits, boxes, (64, 128)))
    assert found.boxes.tolist() == [[0, 0, 60, 60], [13, 5, 67, 63]]
