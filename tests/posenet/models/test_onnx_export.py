"""What runs without Python gives what PyTorch gives."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.config import preset, with_options
from posenet.models import onnx_export
from posenet.network.pose_network import PoseNetwork

RPN = {"detector": "rpn", "roi": "box", "crop_size": 0, "depth": "absolute", "input": "depth-holes"}


def network(debug_shards: Path, **options: object) -> PoseNetwork:
    torch.manual_seed(0)
    config = with_options(preset("debug"), "network", fc_width=32, **options)
    camera = Camera(90, 70, 80.0, 82.0, 44.5, 34.5)  # no multiple of the stride
    return PoseNetwork(config, ShardDataset(debug_shards).header.object, (0.3, 0.6), camera).eval()


@pytest.mark.parametrize("options", [{}, pytest.param(RPN, marks=pytest.mark.slow)], ids=["heatmap", "rpn"])
def test_onnxruntime_gives_what_pytorch_gives(debug_shards: Path, tmp_path: Path, options: dict[str, object]) -> None:
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    model = network(debug_shards, **options)
    trunk, regions, page = onnx_export.export(model, tmp_path / "model.onnx")
    depth, intrinsics, box = onnx_export.example_inputs(model)
    depth = depth * (1 + 0.02 * torch.rand(depth.shape, generator=torch.Generator().manual_seed(0)))
    depth[:, 20:26, 30:40] = 0.0
    box = torch.cat(
        [box, box[:2] + 7.0, torch.tensor([[31.0, 21.0, 38.0, 25.0]])]
    )  # more than the graph was drawn with
    with torch.no_grad():
        wanted = onnx_export.TrunkGraph(model)(depth, intrinsics)
        inputs = {"features": wanted[0], "normals": wanted[1], "depth": depth, "intrinsics": intrinsics, "box": box}
        wanted_regions = onnx_export.RegionGraph(model)(*inputs.values())
    found = run(runtime, trunk, {"depth": depth, "intrinsics": intrinsics})
    found_regions = run(runtime, regions, inputs)
    names = (*onnx_export.TRUNK_OUTPUTS, *onnx_export.REGION_OUTPUTS)
    for name, expected, value in zip(names, (*wanted, *wanted_regions), (*found, *found_regions), strict=True):
        np.testing.assert_allclose(value, expected.numpy(), rtol=1e-3, atol=1e-3, err_msg=name)
    assert found_regions[1][-1] == 0  # a box of holes has no depth
    said = json.loads(page.read_text())
    assert said["image"] == {"width": 96, "height": 72}
    assert said["depth"]["bins"]["count"] == model.config.network.depth_bins


def run(runtime: object, path: Path, inputs: dict[str, torch.Tensor]) -> list[np.ndarray]:
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])  # type: ignore[attr-defined]
    taken = {one.name for one in session.get_inputs()}
    return session.run(None, {name: value.contiguous().numpy() for name, value in inputs.items() if name in taken})


def test_another_suffix_is_refused(debug_shards: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.onnx"):
        onnx_export.export(network(debug_shards), tmp_path / "model.pb")


def test_without_onnx_the_mend_is_named(debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(InputError, match=r"pip install 'binpose-posenet\[export\]'"):
        onnx_export.export(network(debug_shards), tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []
