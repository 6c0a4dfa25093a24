"""A decoder in plain NumPy, fed by the exported graphs and rules alone, gives the poses and scores of `predict`."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.config import preset, with_options
from posenet.exports import onnx_export
from posenet.models.model_file import load_model
from posenet.network.pose_network import PoseNetwork
from posenet.prediction.predictor import Predictor

ROOT = Path(__file__).parents[3]
PAPER = {
    "detector": "rpn", "roi": "box", "crop_size": 0, "depth": "absolute", "input": "depth-holes", "interpolate": False,
    "regress_rotation": False, "confidence": "product", "registration_cells": 2,
}  # fmt: skip
NEAR = 1e-4
ON_THE_EDGE = 1e-3  # share of an untrained network's poses of which a rounding decides whether they are hypotheses

Image = tuple[NDArray[np.float32], Camera]


def decoder(path: Path) -> Callable:
    """That of examples/, which needs ONNX Runtime."""
    pytest.importorskip("onnxruntime")
    spec = importlib.util.spec_from_file_location("onnx_decoder", ROOT / "examples" / "onnx_decoder.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Decoder(path)


def unequal(network: PoseNetwork, folder: Path, images: list[Image]) -> tuple[int, int]:
    """How many poses `predict` gives, and how many of them the decoder has not, with their scores, within NEAR."""
    pytest.importorskip("onnxscript")
    decode = decoder(onnx_export.export(network, folder / "model.onnx")[0])
    predictor = Predictor(network, precision="float32")
    count = missing = 0
    for depth, camera in images:
        wanted = predictor.predict(depth, camera)
        found, score = decode(depth, camera.to_json())
        assert len(found) == len(wanted.score)
        decoded = cKDTree(np.column_stack([found.reshape(len(found), -1), score]))
        predicted = np.column_stack([wanted.cam_from_obj.reshape(len(found), -1), wanted.score])
        off = decoded.query(predicted, p=np.inf, distance_upper_bound=NEAR)[0]  # infinite where there is none
        count, missing = count + len(found), missing + int(np.isinf(off).sum())
    return count, missing


def frames(shards: Path, count: int) -> list[Image]:
    dataset = ShardDataset(shards)
    return [(dataset[number].depth, dataset.header.camera) for number in range(count)]


def test_the_decoder_gives_the_poses_of_predict(run_folder: Path, debug_shards: Path, tmp_path: Path) -> None:
    (depth, camera), *others = frames(debug_shards, 3)
    fine = Camera(camera.width * 2, camera.height * 2, camera.fx * 2, camera.fy * 2, camera.cx * 2, camera.cy * 2)
    cut = Camera(camera.width - 3, camera.height - 13, camera.fx, camera.fy, camera.cx, camera.cy - 13)
    twice = depth.repeat(2, 0).repeat(2, 1)
    images = [*others, (twice, fine), (np.float32(1.8) * twice, fine), (depth[13:, :-3].copy(), cut)]
    count, missing = unequal(load_model(run_folder).network, tmp_path, images)
    assert count > 20 and missing <= ON_THE_EDGE * count


@pytest.mark.slow
def test_so_it_does_for_the_papers_choices(debug_shards: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    config = with_options(preset("debug"), "network", fc_width=32, **PAPER)
    dataset = ShardDataset(debug_shards)
    network = PoseNetwork(config, dataset.header.object, (0.3, 0.6), dataset.header.camera).eval()
    count, missing = unequal(network, tmp_path, frames(debug_shards, 3))
    assert count > 20 and missing == 0


@pytest.mark.slow
def test_so_it_does_for_the_shipped_model_on_fifty_images(
    tmp_path: Path, run_command: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    built = run_command(
        "simgen", "build", "--object", "bunny", "--preset", "demo", "--sensor", "stereo", "--scenes", 10, "--views", 5,
        "--seed", 4242, "-o", tmp_path / "heaps",
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    network = load_model(ROOT / "data" / "models" / "bunny-stereo.pt").network
    count, missing = unequal(network, tmp_path, frames(tmp_path / "heaps", 50))
    assert count > 1000 and missing == 0


def test_another_suffix_is_refused(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.onnx"):
        onnx_export.export(load_model(run_folder).network, tmp_path / "model.pb")


def test_without_onnx_the_mend_is_named(run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(InputError, match=r"pip install 'binpose-posenet\[export\]'"):
        onnx_export.export(load_model(run_folder).network, tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []
