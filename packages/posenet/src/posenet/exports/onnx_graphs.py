"""What is computed of an image, of its regions and of its hypotheses, as three modules that ONNX can express."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from posenet.detectors.rpn import RpnDetector
from posenet.layers.ops import clip_boxes, decode_boxes
from posenet.network.hypotheses import Hypotheses, candidates
from posenet.network.pose_network import PoseNetwork
from posenet.network.stages import ImageFeatures


class TrunkOutputs(NamedTuple):
    """Of one image, with N cells or anchors."""

    features: Tensor  # (1, C, h, w)
    normals: Tensor  # (1, 3, H, W)
    score: Tensor  # (1, N) in [0, 1]
    box: Tensor  # (1, N, 4) x0, y0, x1, y1 in pixels


class RegionOutputs(NamedTuple):
    """Of R regions, with K candidate poses each, best first."""

    reference_depth: Tensor  # (R,) meters, 0: no depth, and so no pose
    refined_score: Tensor  # (R,) in [0, 1]
    refined_box: Tensor  # (R, 4) pixels
    kept: Tensor  # (R, K) bool: the candidate is a hypothesis
    rotation: Tensor  # (R, K, 3, 3) canonical frame to camera
    center: Tensor  # (R, K, 3) meters, in the camera's frame
    relative: Tensor  # (R, K, 3, 3) the rotation in the ray's frame
    confidence: Tensor  # (R, K) logit
    window: Tensor  # (R, 4) pixels; this and what follows is what the candidates are made of
    offset: Tensor  # (R, 2)
    depth_logits: Tensor  # (R, D)
    a_logits: Tensor  # (R, A)
    b_logits: Tensor  # (R, B)
    c_logits: Tensor  # (R, C)
    regressed: Tensor  # (R, 3, 3)


class TrunkGraph(nn.Module):
    """Everything that is computed once an image."""

    def __init__(self, network: PoseNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, depth: Tensor, intrinsics: Tensor) -> TrunkOutputs:
        network = self.network
        images = network.encode(depth, intrinsics)
        raw = network.detector(images.features, images.size)
        if isinstance(network.detector, RpnDetector):
            boxes = decode_boxes(raw.deltas, raw.anchors)
        else:
            boxes = raw.boxes.flatten(1, 2)
        score = raw.logits.flatten(1).sigmoid()
        return TrunkOutputs(images.features, images.normals, score, clip_boxes(boxes, *images.size))


class RegionGraph(nn.Module):
    """Everything that is read off the regions of one image."""

    def __init__(self, network: PoseNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self, features: Tensor, normals: Tensor, depth: Tensor, intrinsics: Tensor, box: Tensor, score: Tensor
    ) -> RegionOutputs:
        network = self.network
        if isinstance(network.detector, RpnDetector):
            (logit,), (delta,) = network.detector.box_head(features, [box])
            box, score = clip_boxes(decode_boxes(delta, box), *depth.shape[-2:]), logit.sigmoid()
        index = torch.zeros_like(box[:, 0], dtype=torch.long)
        images = ImageFeatures(depth, intrinsics, normals, features)
        regions = network.regions(images, box, index)
        outputs = network.read(images, regions)
        most = network.config.network.hypotheses
        found, kept = candidates(outputs, regions, network.codec, network.distance, most)
        confidence = network.confidence_logit(score, outputs, found)
        rows = kept.shape
        return RegionOutputs(
            regions.reference_depth, score, box, kept,
            found.rotation.view(*rows, 3, 3), found.center.view(*rows, 3), found.relative.view(*rows, 3, 3),
            confidence.view(rows), regions.windows, outputs.offset, outputs.depth, *outputs.angles, outputs.rotation,
        )  # fmt: skip


class ScoreGraph(nn.Module):
    """What the n hypotheses of one image know of each other: their final scores."""

    def __init__(self, network: PoseNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        features: Tensor,
        intrinsics: Tensor,
        rotation: Tensor,
        center: Tensor,
        relative: Tensor,
        confidence: Tensor,
        region: Tensor,
    ) -> Tensor:
        network = self.network
        seen = network.seen(features[0], intrinsics[0], rotation, center)
        nothing = torch.zeros_like(confidence)  # what is read off the region has served the confidence already
        found = Hypotheses(region, rotation, center, relative, center[:, :2], nothing, nothing)
        registered = network.registered_logit(confidence, found, seen)
        return network.final_logit(confidence, registered).sigmoid()
