"""The classical peer: what goes to the voting and what becomes of its votes, without the voting itself."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.geometry import poses
from posenet.refinement.refiner import Refiner


@pytest.fixture(scope="module")
def baseline(load_benchmark):
    return load_benchmark("ppf_baseline")


@pytest.fixture(scope="module")
def view(debug_shards):
    return ShardDataset(debug_shards)[0]


def test_the_cloud_has_a_point_and_a_normal_toward_the_camera_for_every_usable_pixel(baseline, view):
    cloud = baseline.oriented_cloud(view.depth, view.camera)
    assert cloud.dtype == np.float32
    assert 0.5 * (view.depth > 0).sum() < len(cloud) <= (view.depth > 0).sum()
    np.testing.assert_allclose(np.linalg.norm(cloud[:, 3:], axis=1), 1.0, atol=1e-3)
    assert ((cloud[:, :3] * cloud[:, 3:]).sum(1) < 0).mean() > 0.99
    u, v = np.round(view.camera.project(cloud[:, :3])).astype(int).T
    np.testing.assert_allclose(cloud[:, 2], view.depth[v, u], atol=1e-6)


def test_many_raw_hypotheses_become_one_fitted_pose_an_instance(baseline, view, debug_shards):
    model = ShardDataset(debug_shards).header.object
    truth = view.instances.cam_from_obj[view.instances.visibility_geometric > 0.9]
    rng = np.random.default_rng(0)
    shaken = np.concatenate([truth] * 5)
    shaken[:, :3, 3] += rng.normal(0, 0.003, (len(shaken), 3))
    wrong = poses.from_rotation_translation(
        poses.random_rotations(rng, 20), rng.normal(0, 0.1, (20, 3)) + np.array([0.0, 0.0, 0.2])
    )
    found = np.concatenate([shaken, wrong])
    votes = np.concatenate([rng.uniform(50, 100, len(shaken)), rng.uniform(10, 60, 20)])
    fitted, score = baseline.refined(Refiner(model), view.depth, view.camera, found, votes)
    best = fitted[np.argsort(-score)[: len(truth)]]
    apart = np.linalg.norm(best[:, None, :3, 3] - truth[None, :, :3, 3], axis=-1)
    assert (apart.min(0) < 0.003).all()


def test_the_poses_of_the_votes_are_meters_again_whatever_unit_they_were_found_in(monkeypatch, load_benchmark):
    pytest.importorskip("cv2")
    voting = load_benchmark("ppf_voting")

    class Result:
        numVotes = 7  # noqa: N815 - OpenCV's name
        pose = np.array([[1.0, 0, 0, 2e6], [0, 1, 0, 0], [0, 0, 1, 1e6], [0, 0, 0, 1]])

    found, votes = voting._arrays([Result()], 1e6)
    np.testing.assert_allclose(found[0, :3, 3], [2.0, 0.0, 1.0])
    assert votes.tolist() == [7.0]
    assert voting._arrays([], 1.0)[0].shape == (0, 4, 4)
    cloud = np.ones((2, 6), np.float32)
    np.testing.assert_allclose(voting._scaled(cloud, 10.0), [[10, 10, 10, 1, 1, 1]] * 2)
