"""The classical peers without OpenCV's voting and matching: what goes to them, and what becomes of their finds."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.symmetry import Symmetry
from evalkit.scoring.distances import Sym


@pytest.fixture(scope="module", autouse=True)
def benchmarks(load_benchmark):
    """Puts benchmarks/ on the path."""
    load_benchmark("commands")


def part(name):
    return importlib.import_module(f"peers.{name}")


@pytest.fixture(scope="module")
def view(debug_shards):
    return ShardDataset(debug_shards)[0]


@pytest.fixture(scope="module")
def model(debug_shards):
    return ShardDataset(debug_shards).header.object


def slanted_plane(camera: Camera, normal: np.ndarray, distance: float) -> np.ndarray:
    return distance / (camera.point_map(np.ones((camera.height, camera.width))) @ normal)


def shaken(truth: np.ndarray, times: int, meters: float, rng: np.random.Generator) -> np.ndarray:
    found = np.concatenate([truth] * times)
    found[:, :3, 3] += rng.normal(0, meters, (len(found), 3))
    return found


def test_a_plane_keeps_its_depth_and_normal_under_noise():
    camera = Camera(80, 60, 100.0, 100.0, 40.0, 30.0)
    normal = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    depth = slanted_plane(camera, normal, 0.9)
    noisy = (depth + np.random.default_rng(0).normal(0, 0.001, depth.shape)).astype(np.float32)
    smooth, found = part("smooth_surface").smooth_surface(noisy, camera, 1.0)
    inner = (slice(6, -6), slice(6, -6))
    assert np.abs(smooth - depth)[inner].max() < 0.001
    assert (found[inner] @ -normal).min() > np.cos(np.radians(5))


def test_the_planes_of_two_surfaces_do_not_mix_at_the_step_between_them():
    camera = Camera(80, 60, 100.0, 100.0, 40.0, 30.0)
    depth = np.full((60, 80), 1.0, np.float32)
    depth[:, 40:] = 1.5
    smooth, _ = part("smooth_surface").smooth_surface(depth, camera, 1.0)
    np.testing.assert_allclose(smooth, depth, atol=1e-5)


def test_both_sides_of_a_thin_wall_stay_in_the_models_cloud():
    front = np.array([[0.001 * i, 0.0, 0.0, 0.0, 0.0, 1.0] for i in range(10)])
    back = front * [1, 1, 1, 1, 1, -1]
    cloud = np.concatenate([front, back])
    thinned = part("ppf").thinned(cloud, 0.05, sides=True)
    assert sorted(thinned[:, 5]) == [-1.0, 1.0]
    assert len(part("ppf").thinned(cloud, 0.05)) == 0  # their mean is no normal


def test_clouds_are_in_millimeters_as_opencv_needs_them(view, model):
    ppf = part("ppf")
    of_model, of_scene = ppf.model_cloud(model), ppf.scene_cloud(view.depth, view.camera, model)
    assert np.ptp(of_model[:, :3], axis=0).max() == pytest.approx(1e3 * np.ptp(model.vertices, axis=0).max(), rel=0.05)
    assert np.median(of_scene[:, 2]) == pytest.approx(1e3 * np.median(view.depth[view.depth > 0]), rel=0.1)
    np.testing.assert_allclose(np.linalg.norm(of_scene[:, 3:], axis=1), 1.0, atol=1e-5)
    assert ((of_scene[:, :3] * of_scene[:, 3:]).sum(1) < 0).mean() > 0.95


def test_hypotheses_about_one_pose_become_one_cluster_with_all_their_votes(model):
    rng = np.random.default_rng(0)
    truth = poses.from_rotation_translation(poses.random_rotations(rng, 2), np.array([[0.0, 0, 0.5], [0.3, 0, 0.5]]))
    found = shaken(truth, 20, 0.02 * model.diameter, rng)
    votes = np.tile([3.0, 2.0], 20)
    clusters, total = part("clustering").clustered(found, votes, model)
    assert total.tolist() == [60.0, 40.0]
    assert (Sym(model)(clusters, truth) < 0.02 * model.diameter).all()


def test_of_two_clusters_inside_each_other_the_stronger_one_stays(model):
    turn = poses.from_axis_angle(np.array([[1.0, 0.0, 0.0]]), np.array([2.5]))
    middle = np.array([0.0, 0.0, 0.5])
    found = np.stack([poses.from_rotation_translation(r, middle - r @ model.centroid) for r in (np.eye(3), turn[0])])
    clusters, total = part("clustering").clustered(found, np.array([5.0, 7.0]), model)
    assert total.tolist() == [7.0]
    np.testing.assert_allclose(clusters[0], found[1], atol=1e-9)


def test_many_raw_hypotheses_become_one_fitted_pose_an_instance(view, model):
    truth = view.instances.cam_from_obj[view.instances.visibility_geometric > 0.9]
    rng = np.random.default_rng(0)
    near = shaken(truth, 5, 0.003, rng)
    wrong = poses.from_rotation_translation(
        poses.random_rotations(rng, 20), rng.normal(0, 0.1, (20, 3)) + np.array([0.0, 0.0, 0.2])
    )
    process = part("post_processing").PostProcessing(model).process
    fitted, score = process(view.depth, view.camera, np.concatenate([near, wrong]), np.ones(len(near) + 20))
    best = fitted[np.argsort(-score)[: len(truth)]]
    apart = np.linalg.norm(best[:, None, :3, 3] - truth[None, :, :3, 3], axis=-1)
    assert (apart.min(0) < 0.003).all()


def test_a_match_of_a_template_on_its_own_view_gives_the_view_s_pose(model):
    linemod = part("linemod")
    camera = Camera(200, 160, 300.0, 300.0, 60.0, 90.0)
    rotation = poses.random_rotations(np.random.default_rng(1), 1)
    side, distance = 128, 8 * model.diameter
    drawn = linemod.Rasterizer(Camera(side, side, 300.0, 300.0, 63.5, 63.5), *model.mesh)
    pose = linemod.centered_at(model, rotation, np.array([[0.0, 0.0, distance]]))
    depth = drawn.render(pose, np.eye(4)).depth[None]
    templates = linemod.Templates(model, rotation, np.array([distance]), depth, 1e-4)
    scene = np.zeros((160, 200), np.float32)
    scene[10:138, 40:168] = np.where(depth[0] > 0, depth[0] + 0.1 * distance, 0)
    found, agreement = templates.poses(scene, camera, np.array([0]), np.array([[40, 10]]))
    center = model.centers(found)[0]
    assert agreement[0] == 1.0
    np.testing.assert_allclose(camera.project(center[None])[0], [103.5, 73.5], atol=1e-6)
    assert center[2] == pytest.approx(1.1 * distance, rel=1e-3)


def test_views_that_a_symmetry_makes_equal_are_one(model, monkeypatch):
    monkeypatch.setattr(part("linemod"), "DIRECTIONS", 50)
    monkeypatch.setattr(part("linemod"), "TURNS", 12)
    view_rotations = part("linemod").view_rotations
    symmetric = model.with_symmetry(Symmetry.parse("revolution"))
    assert len(view_rotations(symmetric)) < 350 < 500 < len(view_rotations(model))


def test_objects_large_in_the_image_are_searched_for_in_a_coarser_one():
    camera = Camera(506, 474, 1152.0, 1152.0, 139.0, 237.0)
    coarse, every = part("linemod").coarser(camera, 0.234, 1.2)
    image = np.zeros((474, 506))[every // 2 :: every, every // 2 :: every]
    assert every == 2 and image.shape == (coarse.height, coarse.width)
    point = np.array([[0.1, -0.05, 1.3]])
    np.testing.assert_allclose(camera.project(point), coarse.project(point) * every + every // 2)


def test_images_are_padded_to_a_size_that_opencv_takes():
    pytest.importorskip("cv2")
    padded = part("linemod_matching").padded
    small = np.ones((158, 169), np.uint16)
    large = padded(np.ones((700, 1000), np.uint16))
    assert padded(small).shape == (480, 640) and padded(small).sum() == small.sum()
    assert large.shape == (720, 1040) and (large[:700, :1000] == 1).all()


def test_every_place_of_the_image_keeps_its_best_matches():
    pytest.importorskip("cv2")
    matching = part("linemod_matching")
    corner = np.array([[3, 3]] * 70 + [[45, 3]])
    similarity = np.append(np.linspace(99, 90, 70), 80.0)
    kept = matching.best_of_each_place(corner, similarity)
    assert kept.tolist() == [*range(matching.PLACE_MOST), 70]


def test_matches_at_one_place_do_not_crowd_out_those_elsewhere(model):
    linemod = part("linemod")
    rotation = poses.random_rotations(np.random.default_rng(2), 101)
    middle = linemod.PLACE * model.diameter * np.array([0.5, 0.5, 20.5])  # of one place
    center = np.tile(middle, (101, 1))
    center[100] += [0.3, 0.0, 0.0]
    strength = np.linspace(1.0, 0.5, 101)
    kept = linemod.spread_out(linemod.centered_at(model, rotation, center), strength, model)
    assert kept.tolist() == [*range(linemod.PLACE_MOST), 100]


def test_a_pose_beyond_the_walls_or_below_the_floor_of_a_bin_counts_for_none(view, model):
    config = {"bin": {"width": 0.3, "depth": 0.2, "height": 0.1, "walls": True}}
    centers = np.array([[0.0, 0, 0.02], [0.14, 0.09, 0.02], [0.16, 0, 0.02], [0, 0.11, 0.02], [0, 0, -0.01]])
    world_from_obj = poses.from_rotation_translation(np.eye(3), centers - model.centroid)
    found = view.cam_from_world @ world_from_obj
    methods = part("methods")
    assert methods.in_bin(found, view, model, config).tolist() == [True, True, False, False, False]
    config["bin"]["walls"] = False
    assert methods.in_bin(found, view, model, config).all() and methods.in_bin(found, view, model, {}).all()
