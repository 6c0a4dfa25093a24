"""The multi-task network: trunk, detector, regions, pose heads, hypotheses, confidence, joint registration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.coding import euler
from posenet.coding.pose_codec import PoseCodec
from posenet.coding.sym_distance import SymDistance
from posenet.config import Config, NetworkConfig
from posenet.detectors.base import Detections, Detector
from posenet.detectors.heatmap import HeatmapDetector
from posenet.detectors.rpn import RpnDetector
from posenet.layers.mean import Mean
from posenet.layers.ops import roi_align
from posenet.network import depth_input, hypotheses, losses, targets
from posenet.network.backbone import Backbone, build_backbone
from posenet.network.confidence import ConfidenceHead
from posenet.network.hypotheses import Hypotheses
from posenet.network.pose_heads import PoseHeads, PoseOutputs
from posenet.network.regions import Regions, make_regions
from posenet.network.registration import (
    HypothesisSet,
    JointRegistration,
    registration_loss,
    registration_targets,
    relation_features,
)
from posenet.network.targets import Batch


class ImagePoses(NamedTuple):
    """What the network says about one image: H hypotheses, best first."""

    rotation: Tensor  # (H, 3, 3) canonical object frame
    center: Tensor  # (H, 3) metres, centroid in the camera's frame
    score: Tensor  # (H,) in [0, 1]
    box: Tensor  # (H, 4) of the detection it comes from
    detection: Tensor  # (H,) number of that detection


class _Scored(NamedTuple):
    """Hypotheses of one image on their way to a score."""

    hypotheses: Hypotheses
    logit: Tensor  # (H,) before registration
    registered: Tensor | None  # (H,) logit after registration
    boxes: Tensor  # (n, 4) of the detections


def build_detector(config: NetworkConfig, backbone: Backbone, object_size: float) -> Detector:
    """The detector that `config` names; `object_size` is the object's diameter in pixels."""
    if config.detector == "heatmap":
        return HeatmapDetector(
            backbone.channels, backbone.stride, object_size, max_detections=config.max_detections, norm=config.norm
        )
    # Anchors from the whole object to what is left of one seen end-on and half hidden.
    sizes = tuple(scale * object_size for scale in (0.4, 0.6, 0.85))
    return RpnDetector(
        backbone.channels,
        backbone.stride,
        sizes,
        fc_width=config.fc_width,
        dropout=config.dropout,
        roi_size=config.roi_size,
        max_detections=config.max_detections,
    )


class PoseNetwork(nn.Module):
    """One network for one object. `forward` gives the training losses, `predict` the poses.

    Args:
        config: all choices. model: the object. depth_range: nearest and farthest centroid of the training set, metres.
        camera: of the training set; the anchors' size follows from it.
    """

    model_box: Tensor

    def __init__(self, config: Config, model: ObjectModel, depth_range: tuple[float, float], camera: Camera) -> None:
        super().__init__()
        self.config, self.model, self.camera, self.depth_range = config, model, camera, depth_range
        net = config.network
        self.codec = PoseCodec(model, net, depth_range)
        turn = self.codec.canonical_from_obj[:3, :3]
        self.distance = SymDistance(model.symmetry.rotated(turn), turn @ model.lam_in_obj @ turn.T)
        self.backbone = build_backbone(net.backbone, in_channels=3, norm=net.norm)
        self.detector = build_detector(config.network, self.backbone, self.object_size)
        a, b, c = self.codec.angle_bins
        self.heads = PoseHeads(self.backbone.channels, (a.count, b.count, c.count), net)
        self.confidence = ConfidenceHead(net.fc_width) if net.confidence == "learned" else None
        self.registration = (
            JointRegistration(net.registration_blocks, net.registration_width) if net.registration else None
        )
        self.register_buffer("model_box", self._model_box(), persistent=False)
        self.bf16 = False

    @property
    def object_size(self) -> float:
        """The object's diameter in pixels at the middle of the training set's depths."""
        return self.camera.fx * self.model.diameter / (sum(self.depth_range) / 2)

    def in_fast_layout(self) -> PoseNetwork:
        """Itself, with convolution weights in the layout (channels last) in which CPUs and GPUs are faster."""
        return self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def main_parameters(self) -> Iterator[nn.Parameter]:
        """What the multi-task losses train."""
        return (p for part in (self.backbone, self.detector, self.heads) for p in part.parameters())

    def scoring_parameters(self) -> Iterator[nn.Parameter]:
        """What is trained on detached features, by an optimiser of its own."""
        parts = [part for part in (self.confidence, self.registration) if part is not None]
        return (p for part in parts for p in part.parameters())

    def forward(self, batch: Batch, scoring_images: int = 0) -> dict[str, Mean]:
        """Unweighted losses of a training batch; scoring ones too, on its first `scoring_images` images.

        Which losses there are, and which parameters take part, follows from the configuration alone: several processes
        that train together never wait for what one of them has not.
        """
        draws = batch.draws()
        batch = batch._replace(depth=self._covered(batch.depth))
        features, normals = self._features(batch.depth, batch.intrinsics)
        image_size = batch.depth.shape[-2:]
        find, ignore = targets.detection_targets(batch, self.config.train.min_visibility)
        with self._autocast():
            found = self.detector.losses(self.detector(features, image_size), find, ignore, draws)
        sample = targets.sample_regions(batch, self.config.train, draws)
        regions = self._regions(batch.depth, batch.intrinsics, sample.boxes, sample.image_index)
        regions, truth = regions.select(regions.valid), sample.poses[regions.valid]
        outputs = self._read(features, normals, batch.depth, regions)
        labels = self.codec.encode(truth, regions.windows, regions.reference_depth, regions.intrinsics)
        found |= losses.pose_losses(outputs, labels, self.codec, self.distance, self.config.loss)
        if scoring_images and (self.confidence is not None or self.registration is not None):
            few = slice(0, scoring_images)
            found |= self._scoring_losses(features.detach()[few], normals[few], batch)
        return found

    @torch.no_grad()
    def predict(self, depth: Tensor, intrinsics: Tensor) -> list[ImagePoses]:
        """Poses for images (B, H, W) in metres with intrinsics (B, 4), in eval mode; one entry an image."""
        depth = self._covered(depth)
        features, normals = self._features(depth, intrinsics)
        return [self._ranked(scored) for scored in self._score(features, normals, depth, intrinsics)]

    @torch.no_grad()
    def read_boxes(
        self, depth: Tensor, intrinsics: Tensor, boxes: Tensor, image_index: Tensor
    ) -> tuple[PoseOutputs, Regions]:
        """What the heads say about n boxes (n, 4) of images `image_index` (n,), in eval mode, and the boxes' regions.

        The detector is left out. Regions that are not `valid` have no depth; nothing follows from their outputs.
        """
        features, normals = self._features(depth, intrinsics)
        regions = self._regions(depth, intrinsics, boxes, image_index)
        return self._read(features, normals, depth, regions), regions

    def _model_box(self) -> Tensor:
        """Lowest and highest corner (2, 3) of the object in its canonical frame."""
        surface = self.model.points if self.model.vertices is None else self.model.vertices
        assert surface is not None, "an object has a mesh or sampled points"
        canonical = poses.apply(self.codec.canonical_from_obj, surface)
        return torch.tensor(np.stack([canonical.min(0), canonical.max(0)]), dtype=torch.float32)

    @contextmanager
    def _autocast(self) -> Iterator[None]:
        """Only layers run in bf16: geometry never does."""
        device = next(self.parameters()).device.type
        with torch.autocast(device, dtype=torch.bfloat16, enabled=self.bf16):
            yield

    def _covered(self, depth: Tensor) -> Tensor:
        """Images (B, H, W) padded until the trunk's cells cover every pixel."""
        return depth_input.pad_to_multiple(depth, self.backbone.stride)

    def _features(self, depth: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor]:
        normals = depth_input.surface_normals(depth, intrinsics)
        image = depth_input.network_input(
            depth, normals, self.config.network, self.model.diameter, self.depth_range
        ).contiguous(memory_format=torch.channels_last)
        with self._autocast():
            return self.backbone(image), normals

    def _regions(self, depth: Tensor, intrinsics: Tensor, boxes: Tensor, image_index: Tensor) -> Regions:
        return make_regions(depth, intrinsics, boxes, image_index, self.config.network, self.model.diameter)

    def _read(self, features: Tensor, normals: Tensor, depth: Tensor, regions: Regions) -> PoseOutputs:
        """Pool the regions' features and crops and run the heads."""
        net = self.config.network
        rois = torch.cat([regions.image_index[:, None].to(regions.windows), regions.windows], 1)
        crops = None
        if net.crop_size:
            crops = depth_input.raw_crops(
                depth, normals, regions.windows, regions.reference_depth, regions.image_index, net.crop_size,
                self.model.diameter / 2,
            )  # fmt: skip
        with self._autocast():
            pooled = roi_align(features, rois, net.roi_size, 1.0 / self.backbone.stride)
            return self.heads(pooled, crops)

    @torch.no_grad()
    def _hypothesise(
        self, features: Tensor, normals: Tensor, depth: Tensor, intrinsics: Tensor
    ) -> Iterator[tuple[PoseOutputs, Hypotheses, Detections]]:
        """For each image its detections, what was read off them, and the hypotheses that follow."""
        with self._autocast():
            detections = self.detector.detect(self.detector(features, depth.shape[-2:]))
        index = torch.cat([torch.full((len(d.scores),), i, device=depth.device) for i, d in enumerate(detections)])
        boxes, scores = torch.cat([d.boxes for d in detections]), torch.cat([d.scores for d in detections])
        regions = self._regions(depth, intrinsics, boxes, index)
        outputs = self._read(features, normals, depth, regions)
        for i in range(len(depth)):
            rows = ((index == i) & regions.valid).nonzero()[:, 0]
            part, region = outputs.select(rows), regions.select(rows)
            few = hypotheses.generate(
                part, self.codec, self.distance, region.windows, region.reference_depth, region.intrinsics,
                self.config.network.hypotheses,
            )  # fmt: skip
            yield part, few, Detections(boxes[rows], scores[rows])

    def _score(self, features: Tensor, normals: Tensor, depth: Tensor, intrinsics: Tensor) -> list[_Scored]:
        """Hypotheses of each image with their logits; gradients reach the scoring parameters only."""
        was_training = self.heads.training, self.detector.training
        self.heads.eval(), self.detector.eval()
        found = list(self._hypothesise(features, normals, depth, intrinsics))
        self.heads.train(was_training[0]), self.detector.train(was_training[1])
        return [self._score_image(*image) for image in found]

    def _score_image(self, outputs: PoseOutputs, few: Hypotheses, detections: Detections) -> _Scored:
        if self.confidence is not None:
            logit = self.confidence(outputs.features, detections.scores, few, self.model.diameter)
        else:
            product = detections.scores[few.detection].clamp(1e-6, 1 - 1e-6).log() + few.log_product
            logit = product - torch.log1p(-product.exp().clamp(max=1 - 1e-6))
        registered = None
        if self.registration is not None:
            angles = torch.stack(euler.to_angles(few.relative), -1)
            claims = HypothesisSet(logit.detach(), few.rotation, few.center, angles, few.detection)
            registered = self.registration(
                relation_features(claims, self.model_box, self.config.network.registration_neighbours)
            )
        return _Scored(few, logit, registered, detections.boxes)

    def _scoring_losses(self, features: Tensor, normals: Tensor, batch: Batch) -> dict[str, Mean]:
        count = len(features)
        scored = self._score(features, normals, batch.depth[:count], batch.intrinsics[:count])
        parts: dict[str, list[Tensor]] = {"confidence": [], "registration": []}
        told = torch.tensor([float(len(image.hypotheses) > 0) for image in scored]).sum()
        for image, truth, visibility in zip(scored, batch.poses, batch.visibility, strict=False):
            few = image.hypotheses
            rotation, center = self.codec.canonical(truth)
            distances = self.distance.between(few.rotation, few.center, rotation, center)
            if self.confidence is not None:
                right = (distances < self.model.threshold).any(1).float()
                loss = nn.functional.binary_cross_entropy_with_logits(image.logit, right, reduction="sum")
                parts["confidence"].append(loss / max(len(few), 1))
            if image.registered is not None:
                wanted = registration_targets(
                    distances, image.logit.detach(), self.model.threshold, visibility < self.config.train.min_visibility
                )
                weighting = self.config.loss.registration_weights
                parts["registration"].append(registration_loss(image.registered, wanted, weighting))
        return {name: Mean.of(torch.stack(few), told) for name, few in parts.items() if few}

    def _ranked(self, scored: _Scored) -> ImagePoses:
        few, logit = scored.hypotheses, self._final_logit(scored)
        order = logit.argsort(descending=True, stable=True)
        few = few.select(order)
        return ImagePoses(few.rotation, few.center, logit[order].sigmoid(), scored.boxes[few.detection], few.detection)

    def _final_logit(self, scored: _Scored) -> Tensor:
        """A learnt confidence and the registration are two opinions; the paper's product is no opinion on its own."""
        if scored.registered is None:
            return scored.logit
        return (scored.logit + scored.registered) / 2 if self.confidence is not None else scored.registered
