"""A trained network for what runs without Python: two ONNX graphs and a page of numbers.

``model.onnx``, once an image::

    depth (1, H, W) meters, 0 = no return, as model.json's camera sees it (of larger images the nearest pixels);
    intrinsics (1, 4) fx, fy, cx, cy
    -> features (1, C, h, w), normals (1, 3, H, W), score (1, N) 0..1, box (1, N, 4) pixels x0, y0, x1, y1

``model-regions.onnx``, for the R boxes that are left when those scored too low, and those that overlap a better one,
are dropped (`least_score` and `nms_iou` of model.json)::

    features, normals, depth, intrinsics as above; box (R, 4)
    -> window (R, 4) pixels, reference_depth (R) meters, offset (R, 2), depth_logits (R, D), a_logits (R, A),
       b_logits (R, B), c_logits (R, C), rotation (R, 3, 3), refined_score (R), refined_box (R, 4)

``model.json`` says how to read them: image size and camera, bins, frames. Decoding, all in the camera's frame:

1.  A region without depth (reference_depth 0) has no pose. `refined_*` replace score and box for the detector "rpn",
    which looks twice; "heatmap" repeats the box and gives the score 1.
2.  z = value of the best depth bin (+ reference_depth if bins are "relative"); value of bin i = low + (i + ½)·(high −
    low) / count. The better read is the mean of the bins i − 1, i, i + 1 by their softmax.
3.  pixel = center of the window − ½ + offset · its sides; center = ((u − cx) z / fx, (v − cy) z / fy, z).
4.  Rotation in the ray's frame: Rz(a)·Ry(b)·Rz(c) of the best bins, or `rotation` where "regressed"; R = ray · that,
    where ray is the smallest rotation that turns (0, 0, 1) into the direction of the center ("egocentric": identity).
5.  cam_from_obj = [R, center] · inverse(obj_from_canonical). The score is the detector's times the bins' softmax.

Confidence head, joint registration and refinement stay with PyTorch.
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
from posenet.detectors.rpn import RpnDetector
from posenet.layers.ops import clip_boxes, decode_boxes
from posenet.network.pose_network import PoseNetwork
from posenet.network.stages import ImageFeatures

FORMAT = "binpose-onnx/1"
OPSET = 18
TRUNK_OUTPUTS = ("features", "normals", "score", "box")
REGION_OUTPUTS = (
    "window", "reference_depth", "offset", "depth_logits", "a_logits", "b_logits", "c_logits", "rotation",
    "refined_score", "refined_box",
)  # fmt: skip


class TrunkGraph(nn.Module):
    """Everything that is computed once an image."""

    def __init__(self, network: PoseNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, depth: Tensor, intrinsics: Tensor) -> tuple[Tensor, ...]:
        network = self.network
        images = network.encode(depth, intrinsics)
        raw = network.detector(images.features, images.size)
        if isinstance(network.detector, RpnDetector):
            boxes = decode_boxes(raw.deltas, raw.anchors)
        else:
            boxes = raw.boxes.flatten(1, 2)
        return images.features, images.normals, raw.logits.flatten(1).sigmoid(), clip_boxes(boxes, *images.size)


class RegionGraph(nn.Module):
    """Everything that is read off the regions of one image."""

    def __init__(self, network: PoseNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self, features: Tensor, normals: Tensor, depth: Tensor, intrinsics: Tensor, box: Tensor
    ) -> tuple[Tensor, ...]:
        network = self.network
        score = torch.ones_like(box[:, 0])
        if isinstance(network.detector, RpnDetector):
            (logit,), (delta,) = network.detector.box_head(features, [box])
            box, score = clip_boxes(decode_boxes(delta, box), *depth.shape[-2:]), logit.sigmoid()
        index = torch.zeros_like(box[:, 0], dtype=torch.long)
        images = ImageFeatures(depth, intrinsics, normals, features)
        regions = network.regions(images, box, index)
        found = network.read(images, regions)
        read = (found.offset, found.depth, *found.angles, found.rotation)
        return regions.windows, regions.reference_depth, *read, score, box


def export(network: PoseNetwork, path: Path) -> list[Path]:
    """Write `path` (….onnx), the graph of the regions and the page of numbers beside it; returns all three.

    Raises:
        InputError: the name does not end in .onnx, or ONNX's Python packages are not installed.
    """
    if path.suffix != ".onnx":
        raise InputError(f"{path}: an ONNX file's name must end in .onnx.")
    network = network.cpu().float().eval()
    network.bf16 = False
    depth, intrinsics, box = example_inputs(network)
    features, normals, *_ = TrunkGraph(network)(depth, intrinsics)
    regions, page = path.with_name(f"{path.stem}-regions.onnx"), path.with_suffix(".json")
    _write(TrunkGraph(network), {"depth": depth, "intrinsics": intrinsics}, TRUNK_OUTPUTS, path)
    inputs = {"features": features, "normals": normals, "depth": depth, "intrinsics": intrinsics, "box": box}
    _write(RegionGraph(network), inputs, REGION_OUTPUTS, regions)
    write_json(page, decoding(network), indent=1)
    return [path, regions, page]


def example_inputs(network: PoseNetwork) -> tuple[Tensor, Tensor, Tensor]:
    """A depth image (1, H, W) of the size that the graphs take, intrinsics (1, 4) and some boxes (R, 4)."""
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


def decoding(network: PoseNetwork) -> dict[str, Any]:
    """What model.json says."""
    codec, detector, net = network.codec, network.detector, network.config.network
    depth, _, _ = example_inputs(network)
    return {
        "format": FORMAT,
        "object": network.model.name,
        "image": {"width": depth.shape[2], "height": depth.shape[1]},
        "camera": network.camera.to_json(),
        "detector": {
            "kind": net.detector,
            "least_score": detector.limits.min_score,
            "nms_iou": detector.limits.nms_iou,
            "most": detector.limits.most((depth.shape[1], depth.shape[2])),
        },
        "depth": {"bins": _bins(codec.depth_bins), "relative": net.depth == "relative"},
        "angles": {name: _bins(bins) for name, bins in zip("abc", codec.angle_bins, strict=True)},
        "orientation": net.orientation,
        "regressed": net.regress_rotation,
        "obj_from_canonical": codec.obj_from_canonical.tolist(),
    }


def _bins(bins: Bins) -> dict[str, Any]:
    return {"count": bins.count, "low": bins.low, "high": bins.high, "circular": bins.circular}


def _write(graph: nn.Module, inputs: dict[str, Tensor], outputs: tuple[str, ...], path: Path) -> None:
    try:
        import onnxscript  # noqa: F401
    except ImportError:
        raise InputError(
            f"{path}: writing ONNX needs further packages; install them with: pip install 'binpose-posenet[export]'."
        ) from None
    shapes = {name: {0: torch.export.Dim("regions", min=1, max=4096)} if name == "box" else {} for name in inputs}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            graph.eval(), tuple(inputs.values()), dynamo=True, opset_version=OPSET, verbose=False,
            input_names=list(inputs), output_names=list(outputs), dynamic_shapes=tuple(shapes.values()),
        )  # fmt: skip
    assert program is not None
    with atomic_path(path) as temporary:
        program.save(temporary, external_data=False)
