"""Refinement finds the truth from nearby, and tells right from wrong by the image alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from evalkit import poses
from evalkit.camera import Camera
from evalkit.objects import ObjectModel
from posenet.refine import Refiner

CAMERA = Camera(160, 120, 180.0, 180.0, 79.5, 59.5)
FLOOR = 0.62


def wedge() -> ObjectModel:
    """A slanted 60 x 40 x 30 mm box without symmetry: convex, so that its depth is that of its front planes."""
    x, y, z = 0.03, 0.02, 0.015
    vertices = np.array(
        [[-x, -y, -z], [x, -y, -z], [x, y, -z], [-x, y, -z], [-x, -y, z], [x / 3, -y, z], [x / 2, y, z / 2], [-x, y, z]]
    )
    faces = ConvexHull(vertices).simplices
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normal * (corners[:, 0] - vertices.mean(0))).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return ObjectModel.from_mesh("wedge", vertices, faces)


def render(model: ObjectModel, cam_from_obj: np.ndarray) -> np.ndarray:
    """Depth of one convex object over a floor: a ray hits it if it enters the last front plane before it leaves any."""
    assert model.vertices is not None and model.faces is not None
    depth = np.full((CAMERA.height, CAMERA.width), FLOOR)
    rays = CAMERA.point_map(np.ones((CAMERA.height, CAMERA.width)))
    corners = poses.apply(cam_from_obj, model.vertices)[model.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = rays @ normal.T
    with np.errstate(divide="ignore"):
        crossing = (normal * corners[:, 0]).sum(-1) / slope
    enter = np.where(slope < 0, crossing, -np.inf).max(-1)
    leave = np.where(slope > 0, crossing, np.inf).min(-1)
    return np.where(enter < leave, np.minimum(enter, depth), depth).astype(np.float32)


@pytest.fixture(scope="module")
def scene() -> tuple[ObjectModel, np.ndarray, np.ndarray]:
    model = wedge()
    turn = poses.from_axis_angle([0.6, 0.7, 0.2], 2.2)
    pose = poses.from_rotation_translation(turn, [0.01, -0.02, 0.5])
    return model, pose, render(model, pose)


def distance(model: ObjectModel, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(model.representatives(a) - model.representatives(b)[..., :1, :], axis=-1).min(-1)


def disturbed(pose: np.ndarray, rng: np.random.Generator, count: int, metres: float, radians: float) -> np.ndarray:
    turn = poses.from_axis_angle(rng.standard_normal((count, 3)), np.full(count, radians))
    shift = pose[:3, 3] + rng.uniform(-metres, metres, (count, 3))
    return poses.from_rotation_translation(turn @ pose[:3, :3], shift)


def test_the_truth_stays_and_is_fully_supported(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    found = Refiner(model).refine(depth, CAMERA, pose[None], np.ones(1))
    assert distance(model, found.cam_from_obj, pose[None]) < 2e-4
    assert found.support[0] > 0.9 and found.violation[0] < 0.05


def test_nearby_poses_move_to_the_truth(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    start = disturbed(pose, np.random.default_rng(0), 30, 0.003, np.radians(8))
    found = Refiner(model).refine(depth, CAMERA, start, np.ones(30))
    before, after = distance(model, start, pose[None]), distance(model, found.cam_from_obj, pose[None])
    assert np.median(after) < 0.1 * np.median(before)
    assert (after < before).mean() > 0.9


def test_the_image_tells_right_poses_from_wrong_ones(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    rng = np.random.default_rng(1)
    wrong = poses.from_rotation_translation(poses.random_rotations(rng, 40), pose[:3, 3])
    found = Refiner(model).refine(depth, CAMERA, np.concatenate([pose[None], wrong]), np.ones(41))
    off = distance(model, found.cam_from_obj, pose[None]) > model.threshold
    assert off.sum() > 10
    assert found.evidence[0] > found.evidence[off].max()


def test_an_instance_is_explained_once(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    start = disturbed(pose, np.random.default_rng(2), 6, 0.001, np.radians(2))
    found = Refiner(model).refine(depth, CAMERA, start, np.linspace(1, 0.5, 6))
    assert (~found.duplicate).sum() == 1


def test_no_hypotheses_and_no_depth_are_no_trouble(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    assert len(Refiner(model).refine(depth, CAMERA, np.zeros((0, 4, 4)), np.zeros(0)).support) == 0
    empty = Refiner(model).refine(np.zeros_like(depth), CAMERA, pose[None], np.ones(1))
    assert empty.support[0] == 0 and np.isfinite(empty.cam_from_obj).all()
