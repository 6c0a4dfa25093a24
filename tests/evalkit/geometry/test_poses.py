"""Rigid transforms form a group, and conversions undo each other, for any batch shape."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.geometry import poses

BATCHES = [(), (7,), (2, 3), (0,)]


def random_poses(batch: tuple[int, ...], seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    count = int(np.prod(batch))
    rotation = poses.random_rotations(rng, count).reshape(*batch, 3, 3)
    return poses.from_rotation_translation(rotation, rng.normal(size=(*batch, 3)))


@pytest.mark.parametrize("batch", BATCHES)
def test_a_pose_and_its_inverse_cancel(batch: tuple[int, ...]) -> None:
    pose = random_poses(batch)
    identity = np.broadcast_to(np.eye(4), (*batch, 4, 4))
    assert pose @ poses.invert(pose) == pytest.approx(identity)
    assert poses.invert(pose) @ pose == pytest.approx(identity)


@pytest.mark.parametrize("batch", BATCHES)
def test_applying_a_product_is_applying_one_after_the_other(batch: tuple[int, ...]) -> None:
    first, second = random_poses(batch, 1), random_poses(batch, 2)
    points = np.random.default_rng(3).normal(size=(*batch, 5, 3))
    assert poses.apply(second @ first, points) == pytest.approx(poses.apply(second, poses.apply(first, points)))


def test_rigid_motions_keep_distances() -> None:
    points = np.random.default_rng(0).normal(size=(6, 3))
    moved = poses.apply(random_poses((4,)), points)
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    assert np.linalg.norm(moved[:, :, None] - moved[:, None], axis=-1) == pytest.approx(np.stack([distance] * 4))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.5, 3.0, np.pi - 1e-9, np.pi])
def test_the_angle_of_a_turn_is_the_angle_it_was_made_with(angle: float) -> None:
    axes = np.random.default_rng(0).normal(size=(20, 3))
    start = poses.random_rotations(np.random.default_rng(1), 20)
    turned = poses.from_axis_angle(axes, angle) @ start
    assert poses.rotation_angle(start, turned) == pytest.approx(np.full(20, angle), abs=1e-12)


def test_turns_about_one_axis_add_up_and_leave_it_alone() -> None:
    axis = np.array([1.0, -2.0, 0.5])
    a, b = 0.7, -1.9
    both = poses.from_axis_angle(axis, a) @ poses.from_axis_angle(axis, b)
    assert both == pytest.approx(poses.from_axis_angle(axis, a + b))
    assert both @ axis == pytest.approx(axis)


def test_axis_angle_broadcasts_axes_against_angles() -> None:
    turns = poses.from_axis_angle(np.eye(3)[:, None], np.linspace(0, 3, 5))
    assert turns.shape == (3, 5, 3, 3)
    assert poses.is_rotation(turns, 1e-12).all()


def test_quaternions_are_xyzw_of_either_sign_and_any_norm() -> None:
    quarter = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    assert poses.from_quaternion_xyzw(quarter) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    q = np.random.default_rng(0).normal(size=(9, 4))
    assert poses.from_quaternion_xyzw(q) == pytest.approx(poses.from_quaternion_xyzw(-3.5 * q))
    assert poses.is_rotation(poses.from_quaternion_xyzw(q), 1e-12).all()


def test_multiplying_quaternions_multiplies_rotations() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 4))
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    product = np.append(vector, a[3] * b[3] - a[:3] @ b[:3])
    rotations = poses.from_quaternion_xyzw(a) @ poses.from_quaternion_xyzw(b)
    assert poses.from_quaternion_xyzw(product) == pytest.approx(rotations)


@pytest.mark.parametrize(
    "matrix",
    [np.diag([1.0, 1, -1]), np.eye(3) * 1.01, np.full((3, 3), np.nan), np.full((3, 3), np.inf), np.zeros((3, 3))],
)
def test_what_is_no_rotation_is_told_apart(matrix: np.ndarray) -> None:
    assert poses.is_rotation(np.stack([matrix, np.eye(3)])).tolist() == [False, True]


def test_a_roughened_rotation_is_mended_to_the_nearest() -> None:
    rng = np.random.default_rng(0)
    rotations = poses.random_rotations(rng, 50)
    mended = poses.nearest_rotation(rotations + rng.normal(0, 0.01, rotations.shape))
    assert poses.is_rotation(mended, 1e-12).all()
    assert poses.rotation_angle(rotations, mended).max() < 0.05
    assert poses.nearest_rotation(rotations) == pytest.approx(rotations)


@pytest.mark.parametrize("batch", [(), (0,), (7,), (2, 3)])
def test_the_nearest_rotation_is_that_of_the_singular_value_decomposition(batch: tuple[int, ...]) -> None:
    matrices = np.random.default_rng(1).normal(size=(*batch, 3, 3))
    u, _, vt = np.linalg.svd(matrices)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    assert poses.nearest_rotation(matrices) == pytest.approx(u @ vt, abs=1e-9)


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), np.outer([1.0, 2, 3], [3.0, 1, 1]), np.zeros((3, 3))])
def test_the_nearest_rotation_of_what_has_several_is_one_of_them(matrix: np.ndarray) -> None:
    assert poses.is_rotation(poses.nearest_rotation(matrix), 1e-12)


def test_what_is_no_number_has_no_nearest_rotation() -> None:
    assert np.isnan(poses.nearest_rotation(np.full((3, 3), np.nan))).all()


def test_random_rotations_are_uniform() -> None:
    rotations = poses.random_rotations(np.random.default_rng(0), 4000)
    assert np.abs(rotations.mean(0)).max() < 0.05
    angle = poses.rotation_angle(np.eye(3), rotations)
    # Haar measure: P(angle <= x) = (x - sin x) / pi
    for x in (1.0, 2.0, 3.0):
        assert (angle <= x).mean() == pytest.approx((x - np.sin(x)) / np.pi, abs=0.03)


def test_the_smallest_turn_between_directions_takes_one_to_the_other() -> None:
    rng = np.random.default_rng(0)
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 40, 3)))
    a, b = np.concatenate([a, a[:4], a[:4]]), np.concatenate([b, a[:4], -a[:4]])  # also equal and opposite ones
    turn = poses.rotation_between(a, b)
    assert np.einsum("nij,nj->ni", turn, a) == pytest.approx(b)
    between = np.arccos(np.clip((a * b).sum(1), -1, 1))
    assert poses.rotation_angle(np.eye(3), turn) == pytest.approx(between, abs=1e-7)
    assert poses.is_rotation(turn, 1e-9).all()
