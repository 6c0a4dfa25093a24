"""Joint registration: relations, targets, loss, and that gossip learns to keep one hypothesis an instance."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from posenet.network import registration
from posenet.network.registration import (
    HypothesisSet,
    JointRegistration,
    Relations,
    registration_loss,
    registration_targets,
    relation_features,
)

MODEL_BOX = torch.tensor([[-0.05, -0.03, -0.04], [0.05, 0.03, 0.04]])
FEATURES = {name: column for column, name in enumerate(registration.RELATION_NAMES)}


def random_rotations(count: int, generator: torch.Generator) -> Tensor:
    q = torch.randn(count, 3, 3, generator=generator, dtype=torch.double)
    u, _, vt = torch.linalg.svd(q)
    return (u * torch.linalg.det(u @ vt)[:, None, None] @ vt).float()


def random_hypotheses(count: int, seed: int = 0, spread: float = 0.3) -> HypothesisSet:
    generator = torch.Generator().manual_seed(seed)
    return HypothesisSet(
        scores=torch.randn(count, generator=generator) * 3,
        rotation=random_rotations(count, generator),
        center=torch.rand(count, 3, generator=generator) * spread + torch.tensor([0.0, 0, 1]),
        angles=(torch.rand(count, 3, generator=generator) - 0.5) * 2 * math.pi,
        detection=torch.arange(count) // 5,
    )


def reordered(hypotheses: HypothesisSet, order: Tensor) -> HypothesisSet:
    return HypothesisSet(*(getattr(hypotheses, name)[order] for name in hypotheses.__dataclass_fields__))


def pair_rows(relations: Relations) -> dict[tuple[int, int], Tensor]:
    return {(i, j): row for (i, j), row in zip(relations.pairs.tolist(), relations.features, strict=True)}


def test_posed_boxes_are_the_extent_of_the_boxs_corners() -> None:
    hypotheses = random_hypotheses(40)
    low, high = registration.posed_boxes(hypotheses.rotation, hypotheses.center, MODEL_BOX)
    corners = torch.cartesian_prod(*MODEL_BOX.T)
    posed = corners @ hypotheses.rotation.mT + hypotheses.center[:, None]
    torch.testing.assert_close(low, posed.amin(1))
    torch.testing.assert_close(high, posed.amax(1))


def test_overlap_of_boxes_counts_their_voxels() -> None:
    generator = torch.Generator().manual_seed(0)
    low = torch.randint(0, 6, (10, 3), generator=generator)
    high = low + torch.randint(1, 6, (10, 3), generator=generator)
    voxels = torch.zeros(10, 12, 12, 12, dtype=torch.bool)
    for grid, (x0, y0, z0), (x1, y1, z1) in zip(voxels, low.tolist(), high.tolist(), strict=True):
        grid[x0:x1, y0:y1, z0:z1] = True
    both = (voxels[:, None] & voxels[None]).flatten(2).sum(-1)
    either = (voxels[:, None] | voxels[None]).flatten(2).sum(-1)
    torch.testing.assert_close(
        registration.box_iou_3d((low.float(), high.float()), (low.float(), high.float())), both / either
    )


def test_neighbors_overlap_or_are_siblings_or_oneself_and_nobody_else_is() -> None:
    hypotheses = random_hypotheses(60)
    boxes = registration.posed_boxes(hypotheses.rotation, hypotheses.center, MODEL_BOX)
    overlap = registration.box_iou_3d(boxes, boxes)
    siblings = hypotheses.detection[:, None] == hypotheses.detection[None]
    expected = (overlap > 0) | siblings
    pairs = relation_features(hypotheses, MODEL_BOX).pairs
    actual = torch.zeros_like(expected)
    actual[pairs[:, 0], pairs[:, 1]] = True
    assert torch.equal(actual, expected)
    assert expected.diagonal().all()
    assert (pairs[1:, 0] >= pairs[:-1, 0]).all(), "sorted by listener, as the maximum over neighbors needs it"


def test_a_relation_holds_the_thirteen_stated_numbers() -> None:
    hypotheses = random_hypotheses(30)
    relations = relation_features(hypotheses, MODEL_BOX)
    assert relations.features.shape == (len(relations.pairs), 13)
    diagonal = (MODEL_BOX[1] - MODEL_BOX[0]).norm()
    own, other = relations.pairs.unbind(1)
    columns = dict(zip(FEATURES, relations.features.T, strict=True))
    torch.testing.assert_close(columns["own score"] * registration.SCORE_UNIT, hypotheses.scores[own])
    torch.testing.assert_close(columns["other's score"] * registration.SCORE_UNIT, hypotheses.scores[other])
    shift = torch.stack([columns[name] for name in ("dx", "dy", "dz")], 1) * diagonal
    torch.testing.assert_close(hypotheses.center[own] + shift, hypotheses.center[other])
    torch.testing.assert_close(columns["distance"] * diagonal, shift.norm(dim=1))
    turns = torch.stack([columns[f"own {name}"] for name in "abc"], 1)
    assert ((turns >= 0) & (turns <= 1)).all()
    for column, name in ((0, "other's a"), (2, "other's c")):
        error = columns[name] * 2 * math.pi - hypotheses.angles[other, column]
        torch.testing.assert_close(error.cos(), torch.ones_like(error))


def test_a_relation_seen_from_the_other_side_is_mirrored() -> None:
    rows = pair_rows(relation_features(random_hypotheses(25), MODEL_BOX))
    swap = [1, 0, 2, 6, 7, 8, 3, 4, 5, 9, 10, 11, 12]
    sign = torch.ones(13)
    sign[9:12] = -1
    for (i, j), row in rows.items():
        torch.testing.assert_close(rows[j, i], row[swap] * sign)


def test_relations_do_not_change_when_everything_moves_together() -> None:
    hypotheses = random_hypotheses(25)
    moved = HypothesisSet(**{**hypotheses.__dict__, "center": hypotheses.center + torch.tensor([0.1, -0.2, 0.4])})
    there, here = relation_features(moved, MODEL_BOX), relation_features(hypotheses, MODEL_BOX)
    assert torch.equal(there.pairs, here.pairs)
    torch.testing.assert_close(there.features, here.features, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("most", [8, 1000])
def test_logits_do_not_depend_on_the_order_of_hypotheses(most: int) -> None:
    torch.manual_seed(0)
    network = JointRegistration(blocks=3)
    hypotheses = random_hypotheses(200, spread=0.15)
    order = torch.randperm(200)
    with torch.no_grad():
        straight = network(relation_features(hypotheses, MODEL_BOX, most))
        shuffled = network(relation_features(reordered(hypotheses, order), MODEL_BOX, most))
    assert straight.std() > 0.01
    torch.testing.assert_close(shuffled, straight[order], atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("count", [0, 1, 2000])
def test_any_number_of_hypotheses_is_taken(count: int) -> None:
    torch.manual_seed(0)
    network = JointRegistration(blocks=1, width=32)
    relations = relation_features(random_hypotheses(count, spread=0.02), MODEL_BOX)  # all overlap all
    assert len(relations.pairs) == count * min(count, registration.MAX_NEIGHBORS)
    logits = network(relations)
    assert logits.shape == (count,)
    loss = registration_loss(logits, -torch.ones(count))
    loss.backward()
    assert torch.isfinite(loss)
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in network.parameters())


def test_of_too_many_neighbors_siblings_and_then_the_closest_stay() -> None:
    hypotheses = random_hypotheses(100, spread=0.02)
    most = 20
    relations = relation_features(hypotheses, MODEL_BOX, most)
    boxes = registration.posed_boxes(hypotheses.rotation, hypotheses.center, MODEL_BOX)
    overlap = registration.box_iou_3d(boxes, boxes)
    for i in range(100):
        heard = set(relations.pairs[relations.pairs[:, 0] == i, 1].tolist())
        siblings = set((hypotheses.detection == hypotheses.detection[i]).nonzero()[:, 0].tolist())
        assert len(heard) == most
        assert i in heard
        assert siblings <= heard
        strangers = torch.tensor([j not in siblings for j in range(100)])
        farthest_heard = overlap[i, sorted(heard - siblings)].min()
        unheard = strangers & ~torch.tensor([j in heard for j in range(100)])
        assert overlap[i, unheard].max() <= farthest_heard + 2e-4


@pytest.mark.parametrize("most", [20, 500])
def test_in_portions_the_neighbors_are_those_of_all_at_once(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    hypotheses = random_hypotheses(100, spread=0.02)
    whole = relation_features(hypotheses, MODEL_BOX, most)
    monkeypatch.setattr(registration, "LISTENERS_AT_ONCE", 7)
    parts = relation_features(hypotheses, MODEL_BOX, most)
    assert torch.equal(pair_set(whole), pair_set(parts))
    assert (whole.pairs[:, 0].diff() >= 0).all() and (parts.pairs[:, 0].diff() >= 0).all()


def pair_set(relations: registration.Relations) -> torch.Tensor:
    """Pairs and their features (P, 15), in one order."""
    rows = torch.cat([relations.pairs.float(), relations.features], 1)
    order = (relations.pairs[:, 0] * relations.count + relations.pairs[:, 1]).argsort()
    return rows[order]


def test_the_maximum_over_neighbors_equals_the_loop() -> None:
    generator = torch.Generator().manual_seed(0)
    counts = torch.randint(1, 6, (20,), generator=generator)
    messages = torch.randn(int(counts.sum()), 7, generator=generator, requires_grad=True)
    actual = registration.max_by_listener(messages, counts)
    expected = torch.stack([part.amax(0) for part in messages.split(counts.tolist())])
    torch.testing.assert_close(actual, expected)
    weights = torch.randn(20, 7, generator=generator)
    (gradient,) = torch.autograd.grad((actual * weights).sum(), messages, retain_graph=True)
    (reference,) = torch.autograd.grad((expected * weights).sum(), messages)
    torch.testing.assert_close(gradient, reference)


def test_merged_images_do_not_hear_each_other() -> None:
    torch.manual_seed(0)
    network = JointRegistration(blocks=2, width=32)
    images = [relation_features(random_hypotheses(n, seed=n), MODEL_BOX) for n in (7, 0, 12)]
    with torch.no_grad():
        together = network(Relations.merged(images))
        apart = torch.cat([network(image) for image in images])
    torch.testing.assert_close(together, apart, atol=1e-5, rtol=1e-4)


def test_the_network_learns_on_detached_inputs() -> None:
    torch.manual_seed(0)
    hypotheses = random_hypotheses(10)
    hypotheses.scores.requires_grad_()
    features = torch.randn(10, 6, requires_grad=True)
    network = JointRegistration(blocks=1, width=32, features=6)
    network(relation_features(hypotheses, MODEL_BOX), features).sum().backward()
    assert hypotheses.scores.grad is None
    assert features.grad is None
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in network.seen.parameters())


def test_a_pair_is_heard_by_what_is_seen_of_both() -> None:
    torch.manual_seed(0)
    network = JointRegistration(blocks=1, width=32, features=6)
    relations = relation_features(random_hypotheses(3, spread=0.0), MODEL_BOX)
    apart = Relations(4, torch.cat([relations.pairs, torch.tensor([[3, 3]])]), relations.features[[*range(9), 0]])
    seen = torch.randn(4, 6)
    with torch.no_grad():
        before = network(apart, seen)
        changed = network(apart, seen + torch.tensor([[0.0], [0], [1], [0]])) - before
    assert (changed[:3].abs() > 1e-6).all(), "its own, and that of its neighbors"
    assert changed[3] == 0, "who is no neighbor is not seen"


def test_registration_computes_in_float32_under_autocast() -> None:
    torch.manual_seed(0)
    network = JointRegistration(blocks=1, width=32)
    relations = relation_features(random_hypotheses(20), MODEL_BOX)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        logits = network(relations)
    torch.testing.assert_close(logits, network(relations), atol=0, rtol=0)


# Targets and loss


def test_one_hypothesis_of_each_instance_is_right_and_it_is_the_best_scored() -> None:
    generator = torch.Generator().manual_seed(0)
    distances, scores = torch.rand(200, 9, generator=generator), torch.randn(200, generator=generator)
    labels = registration_targets(distances, scores, threshold=0.2)
    for instance in range(9):
        speaks = (distances.argmin(1) == instance) & (distances[:, instance] < 0.2)
        assert (labels[speaks] > 0).sum() == min(1, int(speaks.sum()))
        if speaks.any():
            assert scores[speaks & (labels > 0)] == scores[speaks].max()
    assert (labels[distances.amin(1) >= 0.2] == -1).all()
    assert set(labels.tolist()) == {-1.0, 1.0}


def test_with_the_negative_distance_as_the_score_the_nearest_is_right() -> None:
    distances = torch.rand(50, 4, generator=torch.Generator().manual_seed(0)) * 0.1
    labels = registration_targets(distances, -distances.amin(1), threshold=1.0)
    for instance in range(4):
        mine = distances.argmin(1) == instance
        assert labels[mine][distances[mine, instance].argmin()] == 1


def test_hypotheses_of_an_ignored_instance_are_left_out() -> None:
    distances = torch.tensor([[0.01, 1.0], [0.02, 1.0], [1.0, 0.01], [1.0, 1.0]])
    labels = registration_targets(distances, torch.zeros(4), 0.1, ignored=torch.tensor([True, False]))
    assert labels.tolist() == [0, 0, 1, -1]


@pytest.mark.parametrize(("hypotheses", "instances"), [(0, 0), (0, 3), (4, 0)])
def test_without_hypotheses_or_without_instances_nothing_is_right(hypotheses: int, instances: int) -> None:
    distances = torch.zeros(hypotheses, instances)
    labels = registration_targets(distances, torch.zeros(hypotheses), 0.1, torch.zeros(instances, dtype=torch.bool))
    assert labels.tolist() == [-1.0] * hypotheses


def test_paper_weights_are_one_and_sixteen() -> None:
    logits, labels = torch.tensor([0.7, -0.2, 1.1]), torch.tensor([1.0, -1.0, -1.0])
    terms = [math.log1p(math.exp(-y * s)) for y, s in zip(labels.tolist(), logits.tolist(), strict=True)]
    expected = (terms[0] + 16 * terms[1] + 16 * terms[2]) / 33
    assert float(registration_loss(logits, labels, "paper")) == pytest.approx(expected)


def test_balanced_weights_give_both_labels_the_same_say() -> None:
    logits = torch.zeros(101, requires_grad=True)
    labels = torch.tensor([1.0] + [-1.0] * 100)
    registration_loss(logits, labels, "balanced").backward()
    assert logits.grad is not None
    assert float(logits.grad[0]) == pytest.approx(-float(logits.grad[1:].sum()))


@pytest.mark.parametrize("weighting", ["paper", "balanced"])
def test_rows_left_out_do_not_count_and_nothing_costs_nothing(weighting: str) -> None:
    logits, labels = torch.tensor([0.5, -3.0, 9.0]), torch.tensor([1.0, -1.0, 0.0])
    all_three = registration_loss(logits, labels, weighting)  # type: ignore[arg-type]
    torch.testing.assert_close(all_three, registration_loss(logits[:2], labels[:2], weighting))  # type: ignore[arg-type]
    assert registration_loss(logits[2:], labels[2:], weighting) == 0  # type: ignore[arg-type]


# Learning


def crowd(seed: int) -> tuple[Relations, Tensor, Tensor]:
    """Instances with several hypotheses each, good and bad: relations, labels and the scores that came in."""
    generator = torch.Generator().manual_seed(seed)
    instances, each = 8, 4
    owner = torch.arange(instances).repeat_interleave(each)
    center = torch.rand(instances, 3, generator=generator) * 0.4 + torch.tensor([0.0, 0, 1])
    off = torch.randn(len(owner), 3, generator=generator) * 0.008
    seen = torch.randn(instances, generator=generator)  # how well an instance is seen says nothing about duplicates
    scores = seen[owner] - off.norm(dim=1) * 100 + 0.3 * torch.randn(len(owner), generator=generator)
    posed = center[owner] + off
    hypotheses = HypothesisSet(
        scores, torch.eye(3).expand(len(owner), 3, 3), posed, torch.zeros(len(owner), 3), torch.arange(len(owner))
    )
    labels = registration_targets(torch.cdist(posed, center), scores, 0.02)
    return relation_features(hypotheses, MODEL_BOX), labels, scores


def average_precision(scores: Tensor, labels: Tensor) -> float:
    right = labels[scores.argsort(descending=True)] > 0
    precision = right.cumsum(0) / torch.arange(1, len(right) + 1)
    return float(precision[right].sum() / right.sum())


def test_it_learns_to_keep_the_best_hypothesis_of_each_instance() -> None:
    """Duplicates cannot be told by their own score; only gossip can tell them."""
    torch.manual_seed(0)
    scenes = [crowd(seed) for seed in range(60)]
    network = JointRegistration(blocks=1, width=64)
    steps = 150
    optimizer = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
    for _ in range(steps):
        chosen = [scenes[int(i)] for i in torch.randint(len(scenes), (6,))]
        logits = network(Relations.merged([relations for relations, _, _ in chosen]))
        loss = registration_loss(logits, torch.cat([labels for _, labels, _ in chosen]), "balanced")
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    unseen = [crowd(1000 + seed) for seed in range(20)]
    labels = torch.cat([labels for _, labels, _ in unseen])
    with torch.no_grad():
        learned = average_precision(torch.cat([network(relations) for relations, _, _ in unseen]), labels)
    assert average_precision(torch.cat([scores for _, _, scores in unseen]), labels) < 0.8
    assert learned > 0.95
