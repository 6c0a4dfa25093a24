"""Hypotheses are few, distinct, best first, and hold the truth when the marginals do."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry
from posenet.coding import euler
from posenet.coding.pose_codec import PoseCodec
from posenet.coding.sym_distance import SymDistance
from posenet.config import NetworkConfig
from posenet.network import hypotheses
from posenet.network.pose_heads import PoseOutputs
from posenet.network.regions import Regions

SYMMETRIES = ["none", "cyclic:3", "dihedral:2", "octahedral", "revolution", "revolution-flip", "sphere"]


def make_codec(symmetry: str, **options: object) -> tuple[PoseCodec, SymDistance]:
    lam = 0.02 * np.diag([1.0, 1.0, 1.0] if symmetry in ("octahedral", "sphere") else [1.0, 1.0, 1.6])
    model = ObjectModel("thing", 0.1, np.zeros(3), np.eye(4), lam, Symmetry.parse(symmetry), 0.01)
    return PoseCodec(model, NetworkConfig(**options), (0.4, 0.9)), SymDistance(model.symmetry, lam)  # type: ignore[arg-type]


def make_outputs(codec: PoseCodec, count: int, noise: float, seed: int = 0) -> tuple[PoseOutputs, torch.Tensor]:
    """Outputs that say random rotations, with `noise` on the logits; and those rotations."""
    generator = torch.Generator().manual_seed(seed)
    rng = np.random.default_rng(seed)
    truth = codec.canonical_label(torch.from_numpy(poses.random_rotations(rng, count)).float())
    labels = [bins.labels(angle, 0.6) for bins, angle in zip(codec.angle_bins, euler.to_angles(truth), strict=True)]
    depth = codec.depth_bins.labels(torch.zeros(count) + 0.01, 1.2)
    a, b, c, z = (
        label.clamp(min=1e-6).log() + noise * torch.randn(label.shape, generator=generator)
        for label in (*labels, depth)
    )
    return PoseOutputs(torch.zeros(count, 2), z, (a, b, c), truth, torch.zeros(count, 4)), truth


def generate(codec: PoseCodec, distance: SymDistance, outputs: PoseOutputs) -> hypotheses.Hypotheses:
    count = len(outputs.depth)
    windows = torch.tensor([[100.0, 60.0, 160.0, 120.0]]).expand(count, 4)
    intrinsics = torch.tensor([[300.0, 300.0, 159.5, 119.5]]).expand(count, 4)
    valid, index = torch.ones(count, dtype=torch.bool), torch.zeros(count, dtype=torch.long)
    regions = Regions(windows, windows, index, torch.full((count,), 0.6), intrinsics, valid)
    return hypotheses.generate(outputs, regions, codec, distance, 5)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_they_are_sorted_distinct_and_five_at_most(symmetry: str, noise: float) -> None:
    codec, distance = make_codec(symmetry)
    found = generate(codec, distance, make_outputs(codec, 40, noise)[0])
    assert set(found.detection.tolist()) == set(range(40))
    for row in range(40):
        mine = found.select(found.detection == row)
        assert 1 <= len(mine) <= 5
        assert (mine.log_product.diff() <= 0).all()
        apart = distance.pairwise(mine.rotation, mine.center)
        apart.fill_diagonal_(1.0)
        assert apart.min() >= codec.model.threshold


@pytest.mark.parametrize("regress", [True, False])
@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_clear_marginals_put_the_truth_first(symmetry: str, regress: bool) -> None:
    codec, distance = make_codec(symmetry, regress_rotation=regress)
    outputs, truth = make_outputs(codec, 60, 0.0)
    found = generate(codec, distance, outputs)
    first = torch.stack([(found.detection == row).nonzero()[0, 0] for row in range(60)])
    error = distance.rotation_squared(found.relative[first], truth).sqrt()
    assert error.max() < codec.model.threshold


def test_the_papers_bins_alone_give_hypotheses_too() -> None:
    codec, distance = make_codec("none", interpolate=False, regress_rotation=False, depth="absolute")
    found = generate(codec, distance, make_outputs(codec, 10, 1.0)[0])
    assert len(found) <= 50 and torch.isfinite(found.center).all()


def test_no_detections_give_no_hypotheses() -> None:
    codec, distance = make_codec("none")
    assert len(generate(codec, distance, make_outputs(codec, 0, 0.0)[0])) == 0
