"""Distances between poses, each against its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evalkit import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry
from evalkit.scoring.distances import CRITERIA, Add, AddS, Sym, SymToolbox, for_criterion, sym_distance

VGA = (600.0, 610.0, 320.0, 240.0, 640.0)
BAR = np.array([[x, y, z] for x in (-2, 2) for y in (-1, 1) for z in (-0.5, 0.5)]) * 0.02 + [0.01, 0.02, 0.03]


def random_poses(rng, count, spread=0.02):
    turn = poses.from_axis_angle(rng.normal(size=(count, 3)), rng.exponential(0.7, count))
    return poses.from_rotation_translation(turn, rng.normal([0, 0, 0.5], spread, (count, 3)))


def bar(symmetry="none"):
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
             (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    return ObjectModel.from_mesh("bar", BAR, faces, Symmetry.parse(symmetry))


def test_sym_is_the_root_mean_square_motion_of_the_surface():
    rng = np.random.default_rng(0)
    model = bar("dihedral:2")
    a, b = random_poses(rng, 20), random_poses(rng, 20)
    corners = model.vertices[model.faces]
    best = np.full(20, np.inf)
    for turn in model.symmetry.rotations:
        equivalent = a @ poses.from_rotation_translation(turn, model.centroid - turn @ model.centroid)
        moved = poses.apply(equivalent, corners.reshape(-1, 3)) - poses.apply(b, corners.reshape(-1, 3))
        mean_square = [_mean_square(motion, corners) for motion in moved.reshape(20, -1, 3, 3)]
        best = np.minimum(best, np.sqrt(mean_square))
    np.testing.assert_allclose(Sym(model)(a, b), best, rtol=1e-9)


def _mean_square(motion, corners):
    """Of a field linear on each triangle: area-weighted, exact."""
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    square = ((motion**2).sum((1, 2)) + (motion.sum(1) ** 2).sum(1)) / 12
    return (areas * square).sum() / areas.sum()


def test_sym_of_a_revolution_is_the_minimum_over_all_its_turns():
    rng = np.random.default_rng(1)
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    lower, upper = ring * 0.02 - [0, 0, 0.03], ring * 0.01 + [0, 0, 0.05]
    turn = np.arange(240)
    after = (turn + 1) % 240
    faces = np.concatenate([np.c_[turn, after, turn + 240], np.c_[after, after + 240, turn + 240]])
    model = ObjectModel.from_mesh("cone", np.concatenate([lower, upper]), faces, Symmetry.parse("revolution"))
    finite = model.with_symmetry(Symmetry.parse("cyclic:720"))
    a, b = random_poses(rng, 30), random_poses(rng, 30)
    np.testing.assert_allclose(Sym(model)(a, b), Sym(finite)(a, b), rtol=2e-4)


def test_sym_of_equivalent_poses_is_zero(symmetric_model, make_equivalent):
    rng = np.random.default_rng(2)
    pose = random_poses(rng, 50)
    assert Sym(symmetric_model)(make_equivalent(symmetric_model, pose, rng), pose).max() < 1e-12


def test_sym_is_a_distance(symmetric_model):
    rng = np.random.default_rng(3)
    a, b, c = (random_poses(rng, 60) for _ in range(3))
    sym = Sym(symmetric_model)
    np.testing.assert_allclose(sym(a, b), sym(b, a), atol=1e-12)
    assert (sym(a, c) <= sym(a, b) + sym(b, c) + 1e-12).all()
    assert (sym(a, a) < 1e-12).all()


def test_sym_broadcasts(plain_model):
    rng = np.random.default_rng(4)
    a, b = random_poses(rng, 3), random_poses(rng, 5)
    table = sym_distance(plain_model, a[:, None], b[None])
    assert table.shape == (3, 5)
    assert table[2, 4] == pytest.approx(Sym(plain_model)(a[2:], b[4:])[0], abs=1e-15)


def test_the_toolbox_distance_is_the_right_one_where_the_frames_agree():
    """With the object's own frame at the centroid and along the inertial axes the two readings are one."""
    rng = np.random.default_rng(5)
    model = bar("dihedral:2")
    aligned = ObjectModel.from_mesh("bar", BAR - model.centroid, model.faces, model.symmetry)
    turn = aligned.inertial_from_obj[:3, :3]
    aligned = ObjectModel.from_mesh("bar", aligned.vertices @ turn.T, model.faces, model.symmetry.rotated(turn))
    a, b = random_poses(rng, 40), random_poses(rng, 40)
    np.testing.assert_allclose(SymToolbox(aligned)(a, b), Sym(aligned)(a, b), rtol=1e-9)


def test_add_is_the_mean_motion_of_the_vertices():
    rng = np.random.default_rng(6)
    model = bar()
    a, b = random_poses(rng, 10), random_poses(rng, 10)
    for k, distance in enumerate(Add(model)(a, b)):
        motion = poses.apply(a[k], model.vertices) - poses.apply(b[k], model.vertices)
        assert distance == pytest.approx(np.linalg.norm(motion, axis=1).mean(), rel=1e-12)


def test_adds_is_the_mean_distance_of_true_vertices_to_the_nearest_estimated_one():
    rng = np.random.default_rng(7)
    model = bar()
    a, b = random_poses(rng, 5), random_poses(rng, 5)
    for k, distance in enumerate(AddS(model)(a, b)):
        estimated, true = poses.apply(a[k], model.vertices), poses.apply(b[k], model.vertices)
        table = np.linalg.norm(true[:, None] - estimated[None], axis=-1)
        assert distance == pytest.approx(table.min(1).mean(), rel=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_lower_bound_by_which_pairs_are_left_out_holds(criterion, plain_model):
    rng = np.random.default_rng(8)
    distance = for_criterion(criterion, plain_model)
    a, b = random_poses(rng, 300, spread=0.05), random_poses(rng, 300, spread=0.05)
    gap = np.linalg.norm(distance.points(a) - distance.points(b), axis=1)
    assert (distance(a, b, np.tile(VGA, (300, 1))) >= gap - distance.slack - 1e-12).all()


def test_blocks_do_not_change_the_distances(plain_model, monkeypatch):
    rng = np.random.default_rng(9)
    a, b = random_poses(rng, 17), random_poses(rng, 17)
    cameras = np.tile(VGA, (17, 1))
    whole = [for_criterion(criterion, plain_model)(a, b, cameras) for criterion in CRITERIA]
    monkeypatch.setattr("evalkit.scoring.distances.BLOCK_NUMBERS", 50)
    monkeypatch.setattr("evalkit.scoring.bop_distances.BLOCK_NUMBERS", 50)
    for criterion, expected in zip(CRITERIA, whole, strict=True):
        np.testing.assert_allclose(for_criterion(criterion, plain_model)(a, b, cameras), expected, rtol=1e-12)


def test_a_model_without_points_is_refused_where_points_are_needed():
    bare = replace(bar(), points=None, vertices=None)
    for criterion in ("add", "adds", "mssd", "mspd"):
        with pytest.raises(InputError, match="points"):
            for_criterion(criterion, bare)
