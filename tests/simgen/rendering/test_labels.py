"""Labels against a count that takes its time."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.datasets.scene import Instances
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.rendering.labels import label_instances, quantized
from simgen.rendering.rasterizer import Rasterizer, Rendering

CAMERA = Camera(120, 90, 100.0, 100.0, 59.5, 44.5)
MESH = trimesh.creation.annulus(0.03, 0.06, 0.03)
MODEL = ObjectModel.from_mesh("ring", MESH.vertices + 0.01, MESH.faces)
UNIT = 1e-4


def crowd(seed: int, count: int = 12) -> np.ndarray:
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.25, 0.5, count)
    return poses.from_rotation_translation(
        poses.random_rotations(rng, count), np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)) * z[:, None], z])
    )


def rendered(cam_from_obj: np.ndarray, camera: Camera = CAMERA) -> Rendering:
    assert MODEL.vertices is not None and MODEL.faces is not None
    return Rasterizer(camera, MODEL.vertices, MODEL.faces).render(cam_from_obj, np.eye(4))


def labeled(seed: int, drop_out: float = 0.0) -> tuple[Instances, Rendering, np.ndarray]:
    cam_from_obj = crowd(seed)
    rendering = rendered(cam_from_obj)
    depth_raw = quantized(rendering.depth, UNIT)
    depth_raw[np.random.default_rng(seed).random(depth_raw.shape) < drop_out] = 0
    return label_instances(rendering, depth_raw, cam_from_obj, MODEL, CAMERA), rendering, depth_raw


def box_of(mask: np.ndarray) -> list[int]:
    ys, xs = np.nonzero(mask)
    return [xs.min(), ys.min(), xs.max() + 1, ys.max() + 1] if len(xs) else [0, 0, 0, 0]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("drop_out", [0.0, 0.3])
def test_visibility_and_boxes_equal_a_brute_force_count(seed: int, drop_out: float) -> None:
    labels, rendering, depth_raw = labeled(seed, drop_out)
    larger = Camera(360, 270, CAMERA.fx, CAMERA.fy, CAMERA.cx + 120, CAMERA.cy + 90)
    for row, pose in enumerate(crowd(seed)):
        nearest = rendering.instance_id == row + 1
        returned = nearest & (depth_raw > 0)
        whole = rendered(pose[None], larger).instance_id > 0
        assert labels.pixels_geometric[row] == nearest.sum()
        assert labels.pixels_returned[row] == returned.sum()
        assert labels.pixels_full[row] == whole.sum()
        assert labels.visibility_geometric[row] == pytest.approx(nearest.sum() / whole.sum())
        assert labels.visibility_returned[row] == pytest.approx(returned.sum() / whole.sum())
        assert labels.box_returned[row].tolist() == box_of(returned)
        assert labels.box_full[row].tolist() == (np.array(box_of(whole)) - [120, 90, 120, 90]).tolist()


@pytest.mark.parametrize("seed", range(4))
def test_without_holes_in_the_depth_both_shares_are_the_same(seed: int) -> None:
    labels, _, _ = labeled(seed)
    assert np.array_equal(labels.visibility_geometric, labels.visibility_returned)
    assert np.array_equal(labels.pixels_geometric, labels.pixels_returned)


@pytest.mark.parametrize("seed", range(4))
def test_what_the_sensor_loses_changes_the_returned_share_alone(seed: int) -> None:
    ideal, _, _ = labeled(seed)
    for drop_out in (0.1, 0.5, 1.0):
        holed, _, _ = labeled(seed, drop_out)
        assert np.array_equal(holed.visibility_geometric, ideal.visibility_geometric)
        assert (holed.visibility_returned <= holed.visibility_geometric).all()
        assert holed.visibility_returned.sum() < ideal.visibility_returned.sum()


@pytest.mark.parametrize("seed", range(4))
def test_visibility_lies_between_nought_and_one(seed: int) -> None:
    labels, rendering, _ = labeled(seed)
    visibility = labels.visibility("geometric")
    assert (visibility >= 0).all() and (visibility <= 1).all()
    assert 0 < visibility.min() + visibility.max() < 2, "some hide others"
    assert labels.pixels_geometric.sum() == (rendering.instance_id > 0).sum()


def test_an_instance_out_of_sight_has_no_visible_pixel_and_still_a_row() -> None:
    pose = np.eye(4)[None].repeat(2, 0)
    pose[:, :3, 3] = [[0, 0, 0.4], [9.0, 0, 0.4]]
    rendering = rendered(pose)
    labels = label_instances(rendering, quantized(rendering.depth, UNIT), pose, MODEL, CAMERA)
    assert labels.instance.tolist() == [0, 1]
    assert labels.visibility("geometric")[1] == labels.visibility("returned")[1] == 0 and labels.pixels_full[1] > 0
    assert labels.box_returned[1].tolist() == [0, 0, 0, 0]


def test_the_center_is_the_projected_centroid() -> None:
    labels, _, _ = labeled(1)
    centroid = poses.apply(labels.cam_from_obj, MODEL.centroid[None])[:, 0]
    assert np.allclose(labels.center_px, CAMERA.project(centroid), atol=1e-4)
    assert np.abs(labels.center_px - CAMERA.project(labels.cam_from_obj[:, :3, 3])).max() > 0.5


def test_depth_is_rounded_to_its_unit_and_lost_beyond_sixteen_bits() -> None:
    depth = np.array([[0.0, 0.12344, 0.12346, 6.5535, 6.56, 100.0]], np.float32)
    assert quantized(depth, UNIT).tolist() == [[0, 1234, 1235, 65535, 0, 0]]
