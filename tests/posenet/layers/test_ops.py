"""Box and region operations against plain references, loop by loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from posenet.layers import ops


def random_boxes(count: int, seed: int, extent: float = 100.0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    center = torch.rand(count, 2, generator=generator) * extent
    half = torch.rand(count, 2, generator=generator) * extent / 4 + 0.5
    return torch.cat([center - half, center + half], 1)


def random_rois(count: int, images: int, seed: int, extent: float = 100.0) -> Tensor:
    generator = torch.Generator().manual_seed(seed + 1)
    index = torch.randint(images, (count, 1), generator=generator).float()
    return torch.cat([index, random_boxes(count, seed, extent)], 1)


def reference_nms(boxes: Tensor, scores: Tensor, threshold: float) -> list[int]:
    kept: list[int] = []
    for candidate in sorted(range(len(boxes)), key=lambda i: -float(scores[i])):
        overlaps = [float(ops.box_iou(boxes[candidate : candidate + 1], boxes[k : k + 1])) for k in kept]
        if all(overlap <= threshold for overlap in overlaps):
            kept.append(candidate)
    return kept


def reference_bilinear(plane: np.ndarray, y: float, x: float) -> float:
    height, width = plane.shape
    if y < -1 or y > height or x < -1 or x > width:
        return 0.0
    y, x = min(max(y, 0.0), height - 1.0), min(max(x, 0.0), width - 1.0)
    y0, x0 = int(y), int(x)
    y1, x1 = min(y0 + 1, height - 1), min(x0 + 1, width - 1)
    fy, fx = y - y0, x - x0
    top = (1 - fx) * plane[y0, x0] + fx * plane[y0, x1]
    bottom = (1 - fx) * plane[y1, x0] + fx * plane[y1, x1]
    return float((1 - fy) * top + fy * bottom)


def reference_roi_align(features: Tensor, rois: Tensor, size: int, scale: float, ratio: int, aligned: bool) -> Tensor:
    """The definition, sample by sample (Mask R-CNN, section 3; `aligned` as in Detectron2)."""
    out = np.zeros((len(rois), features.shape[1], size, size))
    for r, (index, *box) in enumerate(rois.tolist()):
        x0, y0, x1, y1 = (value * scale - (0.5 if aligned else 0.0) for value in box)
        if not aligned:
            x1, y1 = max(x1, x0 + 1), max(y1, y0 + 1)
        for c, plane in enumerate(features[int(index)].numpy()):
            for i in range(size):
                for j in range(size):
                    total = 0.0
                    for a in range(ratio):
                        for b in range(ratio):
                            y = y0 + (i + (a + 0.5) / ratio) * (y1 - y0) / size
                            x = x0 + (j + (b + 0.5) / ratio) * (x1 - x0) / size
                            total += reference_bilinear(plane, y, x)
                    out[r, c, i, j] = total / ratio**2
    return torch.from_numpy(out)


def test_iou_counts_pixels_of_integer_boxes() -> None:
    generator = torch.Generator().manual_seed(0)
    low = torch.randint(0, 10, (12, 2), generator=generator)
    boxes = torch.cat([low, low + torch.randint(1, 8, (12, 2), generator=generator)], 1)
    masks = torch.zeros(12, 20, 20, dtype=torch.bool)
    for mask, (x0, y0, x1, y1) in zip(masks, boxes.tolist(), strict=True):
        mask[y0:y1, x0:x1] = True
    both = (masks[:, None] & masks[None]).sum((-2, -1))
    either = (masks[:, None] | masks[None]).sum((-2, -1))
    torch.testing.assert_close(ops.box_iou(boxes.float(), boxes.float()), both / either)


def test_empty_and_inverted_boxes_overlap_nothing() -> None:
    boxes = torch.tensor([[0.0, 0, 0, 0], [5, 5, 2, 2], [0, 0, 10, 10]])
    overlaps = ops.box_iou(boxes, boxes)
    assert torch.isfinite(overlaps).all()
    assert overlaps.sum() == 1.0
    assert ops.box_iou(boxes[:0], boxes).shape == (0, 3)


def test_clipped_boxes_lie_in_the_image() -> None:
    boxes = ops.clip_boxes(random_boxes(200, 0, 200.0) - 50, height=80, width=120)
    assert (boxes >= 0).all()
    assert (boxes <= torch.tensor([120.0, 80, 120, 80])).all()


def test_decoding_undoes_encoding() -> None:
    boxes, anchors = random_boxes(500, 0), random_boxes(500, 1)
    torch.testing.assert_close(ops.decode_boxes(ops.encode_boxes(boxes, anchors), anchors), boxes, atol=1e-4, rtol=1e-5)


def test_box_deltas_do_not_depend_on_where_or_how_large_the_pair_is() -> None:
    boxes, anchors = random_boxes(50, 0), random_boxes(50, 1)
    deltas = ops.encode_boxes(boxes, anchors)
    torch.testing.assert_close(ops.encode_boxes(boxes * 3 + 7, anchors * 3 + 7), deltas, atol=1e-4, rtol=1e-4)


def test_decoding_wild_deltas_stays_finite() -> None:
    anchors = random_boxes(20, 0)
    boxes = ops.decode_boxes(torch.full((20, 4), 1e4), anchors)
    assert torch.isfinite(boxes).all()
    scale = (boxes[:, 2:] - boxes[:, :2]) / (anchors[:, 2:] - anchors[:, :2])
    assert scale.max() < math.exp(ops.MAX_LOG_SCALE) * 1.01


@pytest.mark.parametrize("threshold", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_nms_keeps_what_the_greedy_loop_keeps(threshold: float, seed: int) -> None:
    boxes = random_boxes(150, seed)
    scores = torch.rand(150, generator=torch.Generator().manual_seed(seed + 100))
    assert ops.nms(boxes, scores, threshold).tolist() == reference_nms(boxes, scores, threshold)


def test_nms_resolves_a_chain_in_which_every_box_overlaps_only_its_neighbors() -> None:
    left = torch.arange(40.0)
    boxes = torch.stack([left, left * 0, left + 1.9, left * 0 + 1], 1)
    kept = ops.nms(boxes, -left, 0.3)
    assert kept.tolist() == list(range(0, 40, 2))


@pytest.mark.parametrize("portion", [1, 7, 64])
def test_nms_in_portions_is_nms_at_once(monkeypatch: pytest.MonkeyPatch, portion: int) -> None:
    boxes = random_boxes(150, 3)
    scores = torch.rand(150, generator=torch.Generator().manual_seed(3))
    monkeypatch.setattr(ops, "_torchvision_nms", None)
    monkeypatch.setattr(ops, "BOXES_AT_ONCE", portion)
    assert ops.nms(boxes, scores, 0.3).tolist() == reference_nms(boxes, scores, 0.3)


def test_nms_of_nothing_is_nothing() -> None:
    assert ops.nms(torch.zeros(0, 4), torch.zeros(0), 0.5).shape == (0,)


@pytest.mark.parametrize("aligned", [True, False])
@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_roi_align_equals_the_definition(aligned: bool, ratio: int) -> None:
    features = torch.randn(3, 2, 7, 9, generator=torch.Generator().manual_seed(0))
    rois = random_rois(30, 3, 0, extent=80.0)  # the map covers 72 x 56 pixels, so some regions leave it
    expected = reference_roi_align(features, rois, 4, 1 / 8, ratio, aligned)
    actual = ops.roi_align(features, rois, 4, 1 / 8, ratio, aligned)
    torch.testing.assert_close(actual.double(), expected, atol=1e-5, rtol=1e-5)


def test_roi_align_of_a_plane_reads_the_plane() -> None:
    """Features that rise linearly in the image are read exactly, wherever the region lies: the pixel law."""
    v, u = torch.meshgrid(torch.arange(30.0), torch.arange(40.0), indexing="ij")
    features = torch.stack([u + 0.5, v + 0.5])[None] * 8  # the cells' centers, in pixels
    x0, y0, side, size = 61.3, 83.9, 50.0, 5
    pooled = ops.roi_align(features, torch.tensor([[0, x0, y0, x0 + side, y0 + side]]), size, 1 / 8)[0]
    steps = (torch.arange(size) + 0.5) / size * side
    torch.testing.assert_close(pooled[0], (x0 + steps).expand(size, size), atol=1e-3, rtol=0)
    torch.testing.assert_close(pooled[1], (y0 + steps)[:, None].expand(size, size), atol=1e-3, rtol=0)


def test_roi_align_gradient_is_that_of_its_value() -> None:
    features = torch.randn(2, 3, 5, 6, dtype=torch.double, generator=torch.Generator().manual_seed(0))
    features.requires_grad_()
    rois = random_rois(6, 2, 3, extent=45.0)
    direction = torch.randn(6, 3, 3, 3, generator=torch.Generator().manual_seed(1))
    (ops.roi_align(features, rois, 3, 1 / 8) * direction).sum().backward()
    # The operation is linear in the features, so the gradient against any other features gives their value.
    other = torch.randn(2, 3, 5, 6, generator=torch.Generator().manual_seed(2))
    expected = (ops.roi_align(other, rois, 3, 1 / 8) * direction).sum()
    assert features.grad is not None
    torch.testing.assert_close((features.grad * other).sum().float(), expected, atol=1e-3, rtol=1e-4)


def test_roi_align_does_not_care_for_the_memory_layout_or_the_precision() -> None:
    features = torch.randn(2, 8, 15, 20, generator=torch.Generator().manual_seed(0))
    rois = random_rois(10, 2, 0, extent=120.0)
    expected = ops.roi_align(features, rois, 8, 1 / 8)
    channels_last = features.contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(ops.roi_align(channels_last, rois, 8, 1 / 8), expected)
    half = ops.roi_align(features.bfloat16(), rois, 8, 1 / 8)
    assert half.dtype == torch.bfloat16
    torch.testing.assert_close(half.float(), expected, atol=0.03, rtol=0.03)


def test_roi_align_takes_no_regions_one_cell_and_nonsense() -> None:
    features = torch.randn(2, 4, 6, 6)
    assert ops.roi_align(features, torch.zeros(0, 5), 3, 0.125).shape == (0, 4, 3, 3)
    cell = ops.roi_align(features[:, :, :1, :1], torch.tensor([[1.0, 0, 0, 8, 8]]), 2, 0.125)
    torch.testing.assert_close(cell, features[1:, :, :1, :1].expand(1, 4, 2, 2))
    nonsense = torch.tensor([[0, math.nan, 0, 8, 8], [1, -1e9, 0, 1e9, math.inf]])
    assert torch.isfinite(ops.roi_align(features, nonsense, 3, 0.125)).all()


def test_ours_equal_torchvisions() -> None:
    torchvision_ops = pytest.importorskip("torchvision.ops", exc_type=Exception)
    features, rois = torch.randn(3, 8, 15, 20), random_rois(50, 3, 0, extent=170.0)
    for aligned in (True, False):
        expected = torchvision_ops.roi_align(features, rois, 7, 1 / 8, 2, aligned)
        torch.testing.assert_close(ops._roi_align(features, rois, 7, 1 / 8, 2, aligned), expected)
    boxes, scores = random_boxes(300, 1), torch.rand(300)
    assert torchvision_ops.nms(boxes, scores, 0.5).tolist() == reference_nms(boxes, scores, 0.5)
