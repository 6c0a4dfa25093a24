"""What the labels say is what the decoder reads, for every symmetry, wherever in the image."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry
from posenet.coding import euler
from posenet.coding.class_bins import Bins
from posenet.coding.pose_codec import PoseCodec
from posenet.coding.sym_distance import SymDistance
from posenet.config import NetworkConfig

SYMMETRIES = [
    "none",
    "cyclic:2",
    "cyclic:5",
    "dihedral:2",
    "dihedral:3",
    "octahedral",
    "revolution",
    "revolution-flip",
    "sphere",
]
INTRINSICS = torch.tensor([300.0, 310.0, 159.5, 119.5], dtype=torch.float64)


def make_object(symmetry: str, seed: int = 0) -> ObjectModel:
    """A made-up object whose Lambda has the symmetry, in a frame that is askew to it."""
    rng = np.random.default_rng(seed)
    turn = poses.random_rotations(rng, 1)[0]
    group = Symmetry.parse(symmetry, turn)
    axial = symmetry.startswith(("cyclic:5", "dihedral:3", "revolution"))
    moments = (
        np.ones(3) if symmetry in ("octahedral", "sphere") else np.array([1.0, 1.0, 1.7] if axial else [0.8, 1.1, 1.5])
    )
    lam = 0.02 * turn @ np.diag(moments) @ turn.T
    centroid = np.array([0.01, -0.02, 0.005])
    inertial_from_obj = poses.invert(poses.from_rotation_translation(np.eye(3), centroid))
    return ObjectModel("thing", 0.1, centroid, inertial_from_obj, lam, group, 0.01)


def random_poses(rng: np.random.Generator, count: int) -> torch.Tensor:
    """Poses whose centers project all over the image, corners included."""
    pixel = rng.uniform([0, 0], [319, 239], (count, 2))
    pixel[:4] = [[0, 0], [319, 0], [0, 239], [319, 239]]
    depth = rng.uniform(0.4, 0.9, count)
    xy = (pixel - INTRINSICS[2:].numpy()) / INTRINSICS[:2].numpy() * depth[:, None]
    translation = np.concatenate([xy, depth[:, None]], 1)
    return torch.from_numpy(poses.from_rotation_translation(poses.random_rotations(rng, count), translation))


def windows_for(poses_: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    center = poses_[:, :2, 3] / poses_[:, 2:3, 3] * INTRINSICS[:2] + INTRINSICS[2:]
    center = center + torch.from_numpy(rng.uniform(-8, 8, center.shape))
    half = torch.from_numpy(rng.uniform(15, 30, (len(poses_), 2)))
    return torch.cat([center - half, center + half], 1)


def gap_between(a: torch.Tensor, b: torch.Tensor, bins: Bins) -> torch.Tensor:
    if not bins.circular:
        return (a - b).abs()
    return (torch.remainder(a - b + bins.high / 2, bins.high) - bins.high / 2).abs()


@pytest.mark.parametrize("orientation", ["allocentric", "egocentric"])
@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_decoding_the_labels_gives_an_equivalent_pose(symmetry: str, orientation: str) -> None:
    model = make_object(symmetry)
    for depth in ("absolute", "relative"):
        config = NetworkConfig(depth=depth, orientation=orientation)
        codec = PoseCodec(model, config, (0.4, 0.9))
        rng = np.random.default_rng(1)
        truth = random_poses(rng, 200)
        windows, reference = windows_for(truth, rng), truth[:, 2, 3] - 0.01
        labels = codec.encode(truth, windows, reference, INTRINSICS.expand(200, 4))
        relative = euler.from_angles(*labels.angles.unbind(-1))
        rotation, center = codec.decode(labels.offset, labels.depth, relative, windows, reference, INTRINSICS)
        decoded = codec.cam_from_obj(rotation, center)
        difference = model.representatives(decoded) - model.representatives(truth.numpy())[:, :1]
        assert np.linalg.norm(difference, axis=-1).min(-1).max() < 1e-6


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_decoding_the_bins_stays_within_their_resolution(symmetry: str) -> None:
    model = make_object(symmetry)
    codec = PoseCodec(model, NetworkConfig(), (0.4, 0.9))
    rng = np.random.default_rng(2)
    truth = random_poses(rng, 300)
    windows, reference = windows_for(truth, rng), truth[:, 2, 3] - 0.01
    labels = codec.encode(truth, windows, reference, INTRINSICS.expand(300, 4))
    binned = [
        bins.value(bins.index(angle).double())
        for bins, angle in zip(codec.angle_bins, labels.angles.unbind(-1), strict=True)
    ]
    for bins, angle, value in zip(codec.angle_bins, labels.angles.unbind(-1), binned, strict=True):
        if bins.count > 1:
            gap = (angle - value).abs()
            gap = torch.minimum(gap, (bins.high - bins.low) - gap) if bins.circular else gap
            period_gap = torch.remainder(angle - value, bins.high) if bins.circular else gap
            gap = torch.minimum(period_gap, bins.high - period_gap) if bins.circular else gap
            assert gap.max() <= bins.width / 2 + 1e-9
    depth = codec.depth_bins.value(codec.depth_bins.index(labels.depth).double())
    assert (depth - labels.depth).abs().max() <= codec.depth_bins.width / 2 + 1e-9


@pytest.mark.parametrize("orientation", ["allocentric", "egocentric"])
@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_equivalent_poses_have_the_same_labels(symmetry: str, orientation: str) -> None:
    model = make_object(symmetry)
    codec = PoseCodec(model, NetworkConfig(orientation=orientation), (0.4, 0.9))
    rng = np.random.default_rng(3)
    truth = random_poses(rng, 100)
    windows, reference = windows_for(truth, rng), truth[:, 2, 3]
    first = codec.encode(truth, windows, reference, INTRINSICS.expand(100, 4))
    about_centroid = np.eye(4)
    about_centroid[:3, 3] = model.centroid
    for g in model.symmetry.elements(8):
        turn = about_centroid @ poses.from_rotation_translation(g, np.zeros(3)) @ poses.invert(about_centroid)
        other = codec.encode(truth @ torch.from_numpy(turn), windows, reference, INTRINSICS.expand(100, 4))
        torch.testing.assert_close(other.offset, first.offset)
        torch.testing.assert_close(other.depth, first.depth)
        for bins, a, b in zip(codec.angle_bins, first.angles.unbind(-1), other.angles.unbind(-1), strict=True):
            if bins.count > 1:
                period = bins.high if bins.circular else math.inf
                gap = (
                    (a - b).abs()
                    if period == math.inf
                    else torch.remainder(a - b + period / 2, period).sub(period / 2).abs()
                )
                assert gap.max() < 1e-5


def test_allocentric_labels_do_not_depend_on_where_the_object_is() -> None:
    codec = PoseCodec(make_object("none"), NetworkConfig(), (0.4, 0.9))
    turn = torch.from_numpy(poses.random_rotations(np.random.default_rng(4), 1)[0])
    labels = []
    for pixel in ([160.0, 120.0], [5.0, 5.0], [310.0, 230.0]):
        center = torch.tensor(
            [(pixel[0] - 159.5) / 300 * 0.6, (pixel[1] - 119.5) / 310 * 0.6, 0.6], dtype=torch.float64
        )
        rotation = euler.ray_rotation(center) @ turn
        pose = codec.cam_from_obj(rotation[None], center[None])
        window = torch.tensor([[pixel[0] - 20, pixel[1] - 20, pixel[0] + 20, pixel[1] + 20]], dtype=torch.float64)
        labels.append(codec.encode(torch.from_numpy(pose), window, center[2:], INTRINSICS[None]).angles)
    torch.testing.assert_close(labels[0], labels[1])
    torch.testing.assert_close(labels[0], labels[2])


def test_angles_survive_the_poles() -> None:
    for b in (0.0, math.pi, 1e-8, math.pi - 1e-8):
        a = torch.linspace(-3, 3, 7, dtype=torch.float64)
        turn = euler.from_angles(a, torch.full_like(a, b), torch.full_like(a, 0.7))
        torch.testing.assert_close(euler.from_angles(*euler.to_angles(turn)), turn, atol=1e-7, rtol=0)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_distance_agrees_with_evalkit(symmetry: str) -> None:
    model = make_object(symmetry)
    codec = PoseCodec(model, NetworkConfig(), (0.4, 0.9))
    turn = codec.canonical_from_obj[:3, :3]
    distance = SymDistance(model.symmetry.rotated(turn), turn @ model.lam_in_obj @ turn.T).double()
    truth = random_poses(np.random.default_rng(5), 20)
    measured = distance.pairwise(*codec.canonical(truth))
    representatives = model.representatives(truth.numpy())
    expected = np.linalg.norm(representatives[:, None, :, :] - representatives[None, :, :1, :], axis=-1).min(-1)
    np.testing.assert_allclose(measured.numpy(), expected, atol=3e-5)  # float32 group elements


@pytest.mark.parametrize("circular", [True, False])
def test_soft_labels_read_back_the_value_between_bins(circular: bool) -> None:
    bins = Bins(30, 0.0, 2 * math.pi, circular)
    value = torch.linspace(0.3, 5.9, 101)
    read, mass = bins.peaks(bins.labels(value, 0.6).clamp(min=1e-12).log(), 1, interpolate=True)
    assert (read[:, 0] - value).abs().max() < 0.1 * bins.width
    assert mass.exp().min() > 0.95


def test_a_circle_closes() -> None:
    bins = Bins(30, 0.0, 2 * math.pi, circular=True)
    value = torch.tensor([0.001, 2 * math.pi - 0.001])
    read, _ = bins.peaks(bins.labels(value, 0.6).log(), 1, interpolate=True)
    gap = torch.remainder(read[:, 0] - value + math.pi, 2 * math.pi) - math.pi
    assert gap.abs().max() < 0.1 * bins.width
