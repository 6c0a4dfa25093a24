"""A trained network for what runs without Python: three ONNX graphs and a page of rules.

====================  ===============================================================================================
OUT.onnx              once an image: features, and boxes with scores
OUT-regions.onnx      for the boxes that are kept: candidate poses, and how sure each is by itself
OUT-scores.onnx       for the hypotheses that are kept, all of an image: final scores, in view of each other
OUT.json              the rules of what happens before, between and after, by name (:func:`rules`)
====================  ===============================================================================================

What is passed on by hand, and what becomes of a refused box, docs/onnx.md says; examples/onnx_decoder.py does it in
plain NumPy. Any image size will do, in whole steps of the trunk's stride. Fitting to the depth image (`--refine`) is
the only part of prediction that stays behind.
"""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from evalkit.atomic import atomic_path, write_json
from evalkit.errors import InputError
from posenet.coding.class_bins import Bins
from posenet.detectors.base import LEAST_SIDE
from posenet.detectors.heatmap import CANDIDATES
from posenet.detectors.rpn import RpnDetector
from posenet.exports.onnx_graphs import RegionGraph, RegionOutputs, ScoreGraph, TrunkGraph, TrunkOutputs
from posenet.network import depth_input, hypotheses
from posenet.network.pose_network import PoseNetwork
from posenet.prediction import any_camera

FORMAT = "binpose-onnx/2"
OPSET = 18
MOST = 4096  # regions or hypotheses of an image, and cells along its sides


def export(network: PoseNetwork, path: Path) -> list[Path]:
    """Write `path` (….onnx), the two graphs that follow it and the page of rules beside it; returns all four.

    Raises:
        InputError: the name does not end in .onnx, or ONNX's Python packages are not installed.
    """
    if path.suffix != ".onnx":
        raise InputError(f"{path}: an ONNX file's name must end in .onnx.")
    network = network.cpu().float().eval()
    network.bf16 = False
    written = [path, *(path.with_name(f"{path.stem}-{part}.onnx") for part in ("regions", "scores"))]
    for file, graph in zip(written, graphs(network), strict=True):
        _write(*graph, file)
    page = path.with_suffix(".json")
    write_json(page, rules(network), indent=1)
    return [*written, page]


def graphs(network: PoseNetwork) -> list[tuple[nn.Module, dict[str, Tensor], dict[str, Any], tuple[str, ...]]]:
    """The three graphs, each with inputs to draw it by, which of their sizes are free, and its outputs' names."""
    cells, stride = {1: _free("rows"), 2: _free("columns")}, network.backbone.stride
    pixels = {axis: stride * size for axis, size in cells.items()}
    after_channels = {axis + 1: size for axis, size in cells.items()}
    depth, intrinsics, box = example_inputs(network)
    with torch.no_grad():
        trunk = TrunkGraph(network)(depth, intrinsics)
        of_image = {"features": trunk.features, "normals": trunk.normals, "depth": depth, "intrinsics": intrinsics}
        regions = of_image | {"box": box, "score": torch.full_like(box[:, 0], 0.5)}
        read = RegionGraph(network)(*regions.values())
    rows = torch.arange(len(box)).repeat_interleave(read.kept.shape[1])[read.kept.flatten()]
    claims = {name: getattr(read, name)[read.kept] for name in ("rotation", "center", "relative", "confidence")}
    scores = {"features": trunk.features, "intrinsics": intrinsics} | claims | {"region": rows}
    fixed: dict[int, Any] = {}
    of_image_free = {
        "features": after_channels, "normals": {axis + 1: size for axis, size in pixels.items()}, "depth": pixels,
        "intrinsics": fixed,
    }  # fmt: skip
    each_region, each_hypothesis = {0: _free("regions")}, {0: _free("hypotheses")}
    return [
        (TrunkGraph(network), {"depth": depth, "intrinsics": intrinsics}, {"depth": pixels, "intrinsics": fixed},
         TrunkOutputs._fields),
        (RegionGraph(network), regions, of_image_free | {"box": each_region, "score": each_region},
         RegionOutputs._fields),
        (ScoreGraph(network), scores, {"features": after_channels, "intrinsics": fixed}
         | dict.fromkeys([*claims, "region"], each_hypothesis), ("final_score",)),
    ]  # fmt: skip


def example_inputs(network: PoseNetwork) -> tuple[Tensor, Tensor, Tensor]:
    """A depth image (1, H, W) as the training camera takes them, intrinsics (1, 4) and some boxes (R, 4)."""
    camera, stride = network.camera, network.backbone.stride
    height, width = camera.height + -camera.height % stride, camera.width + -camera.width % stride
    slope = torch.linspace(-0.1, 0.1, width) + torch.linspace(-0.05, 0.05, height)[:, None]
    depth = sum(network.depth_range) / 2 * (1 + slope)
    depth[: height // 8] = 0.0
    size, corner = network.object_size, torch.tensor([width / 4, height / 4])
    low = torch.stack([corner, corner * 1.5, corner * 0.9])
    box = torch.cat([low, low + size], 1)
    intrinsics = torch.tensor([[camera.fx, camera.fy, camera.cx, camera.cy]], dtype=torch.float32)
    return depth[None], intrinsics, box


def rules(network: PoseNetwork) -> dict[str, Any]:
    """What OUT.json says; docs/onnx.md explains every name."""
    codec, net = network.codec, network.config.network
    return {
        "format": FORMAT,
        "object": {"name": network.model.name, "diameter": network.model.diameter},
        "image": {
            "camera": network.camera.to_json(),
            "focal_tolerance": any_camera.TOLERANCE,
            "zoom": _zoom(network) if net.depth == "relative" else None,
            "resample": "nearest",
            "multiple_of": network.backbone.stride,
            "pad": "0 at the bottom and right",
        },
        "detections": {
            "least": network.detector.limits.least,
            "per_pixel": network.detector.limits.density,
            **_suppression(network),
        },
        "candidates": _candidates(network),
        "scores": "OUT-scores.onnx",
        "obj_from_canonical": codec.obj_from_canonical.tolist(),
    }


def _zoom(network: PoseNetwork) -> dict[str, Any]:
    near, far = network.depth_range
    return {
        "every_pixel": depth_input.EVERY,
        "plausible": [near - network.model.diameter, far + network.model.diameter],
        "least_plausible": depth_input.LEAST_PLAUSIBLE,
        "unchanged": [near / any_camera.FARTHER, far * any_camera.FARTHER],
        "trained": (near + far) / 2,
        "steps_an_octave": any_camera.STEPS_AN_OCTAVE,
    }


def _suppression(network: PoseNetwork) -> dict[str, Any]:
    """Of boxes before OUT-regions.onnx and, for a detector that looks twice, of refined boxes after it."""
    detector, limits = network.detector, network.detector.limits
    last = {"least_score": limits.min_score, "least_side": LEAST_SIDE, "drop_iou_above": limits.nms_iou, "kept": 1.0}
    if not isinstance(detector, RpnDetector):
        return {"before_regions": {"candidates": float(CANDIDATES)} | last, "after_regions": None}
    first = {
        "candidates": detector.candidates / limits.least,
        "least_score": 0.0,
        "least_side": LEAST_SIDE,
        "drop_iou_above": detector.proposal_iou,
        "kept": detector.proposals / limits.least,
    }
    return {"before_regions": first, "after_regions": {"candidates": None} | last}


def _candidates(network: PoseNetwork) -> dict[str, Any]:
    """How OUT-regions.onnx makes its candidates of the bins: for whoever decodes these otherwise."""
    codec, net = network.codec, network.config.network
    return {
        "depth": _bins(codec.depth_bins) | {"modes": hypotheses.DEPTH_MODES, "relative": net.depth == "relative"},
        "angles": {
            name: _bins(bins) | {"modes": modes}
            for name, bins, modes in zip("abc", codec.angle_bins, hypotheses.MODES, strict=True)
        },
        "mode": "three-bin mean" if net.interpolate else "bin",
        "regressed": net.regress_rotation,
        "orientation": net.orientation,
        "best_products": hypotheses.KEPT_PRODUCTS,
        "drop_sym_below": network.model.threshold,
        "kept": net.hypotheses,
    }


def _bins(bins: Bins) -> dict[str, Any]:
    return {"count": bins.count, "low": bins.low, "high": bins.high, "circular": bins.circular}


def _free(name: str) -> Any:
    return torch.export.Dim(name, min=1 if name in ("regions", "hypotheses") else 2, max=MOST)


def _write(
    graph: nn.Module, inputs: dict[str, Tensor], free: dict[str, Any], outputs: tuple[str, ...], path: Path
) -> None:
    try:
        import onnxscript  # noqa: F401
    except ImportError:
        raise InputError(
            f"{path}: writing ONNX needs further packages; install them with: pip install 'binpose-posenet[export]'."
        ) from None
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            graph.eval(), tuple(inputs.values()), dynamo=True, opset_version=OPSET, verbose=False,
            input_names=list(inputs), output_names=list(outputs),
            dynamic_shapes=tuple(free[name] for name in inputs),
        )  # fmt: skip
    assert program is not None
    with atomic_path(path) as temporary:
        program.save(temporary, external_data=False)
