"""What the image shows of poses: shares that add up, and outlines that are met only where objects end."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.geometry import poses
from evalkit.objects.model import sample_surface_with_normals
from posenet.refinement.appearance import NAMES, appearance

SIZE = np.array([0.06, 0.05, 0.04])
DIAMETER = float(np.linalg.norm(SIZE))
INTRINSICS = np.array([400.0, 400.0, 159.5, 119.5])
FRONT, FLOOR = 0.48, 0.62
FACING = poses.from_rotation_translation(np.eye(3), [0.0, 0.0, FRONT + SIZE[2] / 2])


@pytest.fixture(scope="module")
def surface() -> tuple[np.ndarray, np.ndarray]:
    block = trimesh.creation.box(SIZE)
    return sample_surface_with_normals(np.asarray(block.vertices), np.asarray(block.faces), 1500)


def image_of_the_block(angle: float = 0.0) -> np.ndarray:
    """Depth (240, 320) of the block that faces the camera over the floor, turned about the camera's axis."""
    v, u = (np.mgrid[:240, :320] - np.array([119.5, 159.5])[:, None, None]) * FRONT / 400
    x, y = np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u
    inside = (abs(x) < SIZE[0] / 2) & (abs(y) < SIZE[1] / 2)
    return np.where(inside, FRONT, FLOOR).astype(np.float32)


def seen(surface: tuple[np.ndarray, np.ndarray], depth: np.ndarray, cam_from_obj: np.ndarray) -> list[dict[str, float]]:
    normals = np.zeros((*depth.shape, 3), np.float32)
    normals[..., 2] = -1.0
    found = appearance(cam_from_obj, *surface, np.zeros(3), DIAMETER, depth, normals, INTRINSICS, 0.04 * DIAMETER)
    return [dict(zip(NAMES, row, strict=True)) for row in found.tolist()]


def test_a_pose_that_the_image_shows_is_near_and_ends_where_the_object_ends(
    surface: tuple[np.ndarray, np.ndarray],
) -> None:
    angles = np.linspace(0.2, 1.4, 8)
    turned = [
        FACING @ poses.from_rotation_translation(poses.from_axis_angle([0, 0, 1.0], a), np.zeros(3)) for a in angles
    ]
    rows = [seen(surface, image_of_the_block(a), pose[None])[0] for a, pose in zip(angles, turned, strict=True)]
    mean = {name: float(np.mean([row[name] for row in rows])) for name in NAMES}
    assert mean["near"] > 0.93 and mean["fine"] > 0.93 and mean["agreement"] > 0.9
    assert mean["outline met"] > 0.5 > mean["outline missed"]


def test_within_a_larger_surface_no_outline_is_met(surface: tuple[np.ndarray, np.ndarray]) -> None:
    (lost,) = seen(surface, np.full((240, 320), FRONT, np.float32), FACING[None])
    assert lost["near"] > 0.98
    assert lost["outline missed"] > 0.95 and lost["outline met"] == 0


def test_what_is_in_front_hides_and_what_is_behind_is_looked_through(surface: tuple[np.ndarray, np.ndarray]) -> None:
    here = FACING[None]
    for depth, name in ((0.3, "hidden"), (0.9, "through")):
        (row,) = seen(surface, np.full((240, 320), depth, np.float32), here)
        assert row[name] == pytest.approx(1.0) and row["near"] == 0.0


def test_of_what_does_not_return_and_beyond_the_frame_nothing_is_known(
    surface: tuple[np.ndarray, np.ndarray],
) -> None:
    aside = np.array(FACING)
    aside[0, 3] = 5.0
    beyond = seen(surface, image_of_the_block(), aside[None])[0]
    no_return = seen(surface, np.zeros((240, 320), np.float32), FACING[None])[0]
    assert not any(beyond.values()) and not any(no_return.values())


def test_shares_are_shares(surface: tuple[np.ndarray, np.ndarray]) -> None:
    rng = np.random.default_rng(0)
    turns = poses.random_rotations(rng, 60)
    some = poses.from_rotation_translation(turns, rng.uniform([-0.3, -0.2, 0.3], [0.3, 0.2, 0.7], (60, 3)))
    depth = image_of_the_block()
    depth[100:110] = 0.0
    for row in seen(surface, depth, some):
        assert row["through"] + row["hidden"] + row["near"] <= 1.0 + 1e-9
        assert row["agreement"] <= row["near"] + 1e-9 and row["far through"] <= row["through"]
        assert all(0.0 <= share <= 1.0 + 1e-9 for share in row.values())


def test_what_an_object_hides_of_itself_counts_for_nothing() -> None:
    """Of two blocks one behind the other the camera sees the first only."""
    near, far = trimesh.creation.box(SIZE), trimesh.creation.box(SIZE / 2)
    far.apply_translation([0.0, 0.0, 0.06])
    both = trimesh.util.concatenate([near, far])
    surface = sample_surface_with_normals(np.asarray(both.vertices), np.asarray(both.faces), 1500)
    (row,) = seen(surface, image_of_the_block(), FACING[None])
    assert row["near"] > 0.93
