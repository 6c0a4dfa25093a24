"""Will it work here? What differs from training is named, each with its mend."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from evalkit.datasets.documents import PredictionImage
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.evidence import verdict
from evalkit.evidence.verdict import Verifier
from evalkit.evidence.verification import verify_image
from evalkit.geometry.camera import Camera
from posenet.checking.advice import Finding, Grade, findings, worst
from posenet.checking.floor import above_floor
from posenet.checking.site import LookedAt, Site
from posenet.commands.cli import main
from posenet.models.model_file import load_model
from posenet.network.pose_network import PoseNetwork
from posenet.training.data_statistics import data_statistics

CAMERA = Camera(80, 60, 80.0, 80.0, 39.5, 29.5)


def seen(shards: Path, scale: float = 1.0, extra: float = 0.0, truth: bool = True) -> Site:
    """The true poses (or others) of an image, the scene `scale` times as far and large, with noise (meters)."""
    view = ShardDataset(shards)[0]
    model = ShardDataset(shards).header.object
    depth = view.depth * (view.depth > 0)
    depth = (depth + extra * np.random.default_rng(0).standard_normal(depth.shape) * (depth > 0)).astype(np.float32)
    poses = view.instances.cam_from_obj.copy()
    if not truth:
        poses[:, 2, 3] -= 0.15
    image = PredictionImage("a", poses, view.instances.visibility_geometric)
    found = verify_image(image, depth, view.camera, Verifier(model))
    camera = replace(view.camera, fx=view.camera.fx / scale, fy=view.camera.fy / scale)
    return Site([LookedAt(depth, camera, found, 0.5, 100, 60)], model)


@pytest.fixture(scope="module")
def network(run_folder: Path) -> PoseNetwork:
    return load_model(run_folder).network


def finding(found: list[Finding], title: str) -> Finding:
    return next(one for one in found if one.title == title)


def record(shards: Path) -> dict[str, object]:
    return {"data": data_statistics(ShardDataset(shards))}


def test_images_like_those_of_training_raise_no_doubt(debug_shards: Path, network: PoseNetwork) -> None:
    found = findings(seen(debug_shards), network, record(debug_shards), "run", "frames")
    assert worst(found) is Grade.FINE, found
    assert not any(one.mend for one in found)


def test_other_distances_say_how_to_train(debug_shards: Path, network: PoseNetwork) -> None:
    network = PoseNetwork(network.config, network.model, (0.2, 0.25), network.camera)
    found = finding(findings(seen(debug_shards), network, {}, "run", "frames"), "Distance to the parts")
    assert found.grade is Grade.DOUBTFUL
    near, far = map(float, found.mend.removeprefix("Train with --distance ").rstrip(".").split("-"))
    assert near <= seen(debug_shards).distance[0] and far >= seen(debug_shards).distance[1]


def test_small_parts_noise_and_wrong_poses_are_named(debug_shards: Path, network: PoseNetwork) -> None:
    data = record(debug_shards)
    cases = [
        (seen(debug_shards, scale=4.0), "Size of a part", "nearer"),
        (seen(debug_shards, extra=0.02), "Noise", "simgen sensor fit"),
        (seen(debug_shards, truth=False), "Poses", "mesh"),
    ]
    for site, title, says in cases:
        one = finding(findings(site, network, data, "run", "frames"), title)
        assert one.grade is not Grade.FINE and says in one.mend, one


def test_poses_of_which_most_are_undecided_are_doubted(
    debug_shards: Path, network: PoseNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verdict, "MOST_GOING_ON", -1.0)
    one = finding(findings(seen(debug_shards), network, record(debug_shards), "run", "frames"), "Poses")
    assert one.grade is not Grade.FINE and one.mend


def test_an_older_model_says_that_it_does_not_know(debug_shards: Path, network: PoseNetwork) -> None:
    found = findings(seen(debug_shards), network, {}, "run", "frames")
    for title in ("Noise", "Holes"):
        assert "older model" in finding(found, title).trained


def test_statistics_of_shards_are_theirs(debug_shards: Path) -> None:
    dataset = ShardDataset(debug_shards)
    found = data_statistics(dataset)
    near, far = found["distance_m"]
    assert 0.1 < near < far < 2.0
    assert found["object_pixels"][0] == pytest.approx(
        dataset.header.camera.fx * dataset.header.object.diameter / far, rel=0.01
    )
    assert found["noise_m"] < 1e-3 and 0 <= found["holes"] < 0.05
    json.dumps(found)


def test_the_floor_is_no_part_of_the_heap() -> None:
    depth = np.full((60, 80), 0.6, np.float32)
    depth += np.arange(60, dtype=np.float32)[:, None] * 1e-3  # a slanted floor
    depth[20:40, 30:50] -= 0.05
    heap = above_floor(depth, CAMERA, 0.1)
    assert heap[25:35, 35:45].all() and heap.sum() == 400
    depth[:5] = 0
    assert not above_floor(depth, CAMERA, 0.1)[:5].any()
    rough = (0.5 + 0.1 * np.random.default_rng(0).random((60, 80))).astype(np.float32)
    assert above_floor(rough, CAMERA, 0.1).all()  # no floor is seen
    assert not above_floor(np.zeros((60, 80), np.float32), CAMERA, 0.1).any()


def test_a_check_prints_its_findings_and_draws_its_page(run_folder: Path, debug_shards: Path, tmp_path: Path) -> None:
    page, figures = tmp_path / "check.html", tmp_path / "check.json"
    words = ["check", run_folder, debug_shards, "--max-images", "2", "-o", page, "--json", figures, "--device", "cpu"]
    done = CliRunner().invoke(main, list(map(str, words)))
    assert done.exit_code == 0, done.output
    for title in ("Poses", "Distance to the parts", "Size of a part", "Noise", "Holes"):
        assert f" {title}: " in done.output
    html = page.read_text()
    assert html.count("<figure>") == 2 and "older model" not in html
    document = json.loads(figures.read_text())
    assert document["format"] == "binpose-check/1" and document["images"] == 2
    refused = CliRunner().invoke(main, ["check", str(run_folder), str(debug_shards), "-o", str(tmp_path / "check.txt")])
    assert refused.exit_code == 2 and ".html" in refused.output
    np.save(tmp_path / "empty.npy", np.zeros((60, 80), np.float32))
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    words = ["check", str(run_folder), str(tmp_path / "empty.npy"), "--camera", str(tmp_path / "camera.json")]
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code == 2 and "holds no depth" in refused.output
