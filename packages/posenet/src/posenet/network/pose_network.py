"""The multi-task network: trunk, detector, regions, pose heads, hypotheses, confidence, joint registration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.coding import euler
from posenet.coding.pose_codec import PoseCodec
from posenet.coding.sym_distance import SymDistance
from posenet.config import Config
from posenet.detectors.base import DetectionLimits, Detections
from posenet.detectors.limits import build_detector
from posenet.layers.mean import Mean
from posenet.layers.ops import roi_align
from posenet.network import depth_input, hypotheses, losses, targets
from posenet.network.backbone import build_backbone
from posenet.network.confidence import ConfidenceHead
from posenet.network.hypotheses import Hypotheses
from posenet.network.pose_heads import PoseHeads, PoseOutputs
from posenet.network.predict_options import PredictOptions
from posenet.network.regions import Regions, make_regions
from posenet.network.registration import (
    HypothesisSet,
    JointRegistration,
    registration_loss,
    registration_targets,
    relation_features,
)
from posenet.network.seen_boxes import box_around, outermost_points, pooled_features, seen_boxes
from posenet.network.stages import ImageFeatures, ImagePoses, Proposals, Scored
from posenet.network.targets import Batch

AS_TRAINED = PredictOptions()
REGIONS_AT_ONCE = 256


class PoseNetwork(nn.Module):
    """One network for one object. `forward` gives the training losses, `predict` the poses.

    Args:
        config: all choices. model: the object. depth_range: nearest and farthest centroid of the training set, meters.
        camera: of the training set; the anchors' size follows from it.
    """

    model_box: Tensor  # (2, 3) lowest and highest corner, canonical frame
    outermost: Tensor  # (P, 3) points that span its box in any pose

    def __init__(self, config: Config, model: ObjectModel, depth_range: tuple[float, float], camera: Camera) -> None:
        super().__init__()
        self.config, self.model, self.camera, self.depth_range = config, model, camera, depth_range
        net = config.network
        self.codec = PoseCodec(model, net, depth_range)
        turn = self.codec.canonical_from_obj[:3, :3]
        self.distance = SymDistance(model.symmetry.rotated(turn), turn @ model.lam_in_obj @ turn.T)
        self.backbone = build_backbone(net.backbone, in_channels=3, norm=net.norm)
        self.detector = build_detector(net, self.backbone.channels, self.backbone.stride, model, self.object_size)
        a, b, c = self.codec.angle_bins
        self.heads = PoseHeads(self.backbone.channels, (a.count, b.count, c.count), net)
        self.confidence = ConfidenceHead(net.fc_width) if net.confidence == "learned" else None
        seen = self.backbone.channels * net.registration_cells**2
        self.registration = (
            JointRegistration(net.registration_blocks, net.registration_width, seen) if net.registration else None
        )
        surface = self._canonical_surface()
        self.register_buffer("model_box", box_around(surface), persistent=False)
        self.register_buffer("outermost", outermost_points(surface), persistent=False)
        self.bf16 = False

    @property
    def object_size(self) -> float:
        """The object's diameter in pixels at the middle of the training set's depths."""
        return self.camera.fx * self.model.diameter / (sum(self.depth_range) / 2)

    def in_fast_layout(self) -> PoseNetwork:
        """Itself, with convolution weights in the layout (channels last) in which CPUs and GPUs are faster."""
        to: Callable[..., PoseNetwork] = self.to  # older releases of PyTorch do not declare memory_format
        return to(memory_format=torch.channels_last)

    def main_parameters(self) -> Iterator[nn.Parameter]:
        """What the multi-task losses train."""
        return (p for part in (self.backbone, self.detector, self.heads) for p in part.parameters())

    def scoring_parameters(self) -> Iterator[nn.Parameter]:
        """What is trained on detached features, by an optimizer of its own."""
        parts = [part for part in (self.confidence, self.registration) if part is not None]
        return (p for part in parts for p in part.parameters())

    def forward(self, batch: Batch, scoring_images: int = 0) -> dict[str, Mean]:
        """Unweighted losses of a training batch; scoring ones too, on its first `scoring_images` images.

        Which losses there are, and which parameters take part, follows from the configuration alone: several processes
        that train together never wait for what one of them has not.
        """
        draws = batch.draws()
        shift = targets.reference_shift(draws, self.config.train.reference_jitter)
        images = self.encode(batch.depth, batch.intrinsics, shift.to(batch.depth))
        find, ignore = targets.detection_targets(batch, self.config.train.min_visibility)
        with self._autocast():
            found = self.detector.losses(self.detector(images.features, images.size), find, ignore, draws)
        sample = targets.sample_regions(batch, self.config.train, draws)
        regions = self.regions(images, sample.boxes, sample.image_index)
        regions, truth = regions.select(regions.valid), sample.poses[regions.valid]
        outputs = self.read(images, regions)
        labels = self.codec.encode(truth, regions.windows, regions.reference_depth, regions.intrinsics)
        found |= losses.pose_losses(outputs, labels, self.codec, self.distance, self.config.loss)
        if scoring_images and (self.confidence is not None or self.registration is not None):
            found |= self._scoring_losses(images.first(scoring_images), batch)
        return found

    @torch.no_grad()
    def predict(self, depth: Tensor, intrinsics: Tensor, options: PredictOptions = AS_TRAINED) -> list[ImagePoses]:
        """Poses for images (B, H, W) in meters with intrinsics (B, 4), in eval mode; one entry an image."""
        images = self.encode(depth, intrinsics)
        scored = (self.score(proposals, options) for proposals in self.propose(images, options))
        return [self.rank(image) for image in scored]

    @contextmanager
    def predicting(self, bf16: bool) -> Iterator[None]:
        """Within the block the network is in eval mode, its layers in bf16 or not; afterwards it is as it was."""
        was_training, had = self.training, self.bf16
        self.eval()
        self.bf16 = bf16
        try:
            yield
        finally:
            self.train(was_training)
            self.bf16 = had

    def encode(self, depth: Tensor, intrinsics: Tensor, shift: Tensor | None = None) -> ImageFeatures:
        """Images (B, H, W) in meters through the trunk, padded until its cells cover them; `shift` (B,) in training."""
        depth = depth_input.pad_to_multiple(depth, self.backbone.stride)
        normals = depth_input.surface_normals(depth, intrinsics)
        image = depth_input.network_input(
            depth, normals, self.config.network, self.model.diameter, self.depth_range, shift
        ).contiguous(memory_format=torch.channels_last)
        with self._autocast():
            return ImageFeatures(depth, intrinsics, normals, self.backbone(image))

    @torch.no_grad()
    def detect(self, images: ImageFeatures, limits: DetectionLimits | None = None) -> list[Detections]:
        """Boxes of instances in each image."""
        with self._autocast():
            return self.detector.detect(self.detector(images.features, images.size), limits)

    def regions(self, images: ImageFeatures, boxes: Tensor, image_index: Tensor) -> Regions:
        """The windows that poses are read from, for boxes (n, 4) on images `image_index` (n,)."""
        return make_regions(
            images.depth, images.intrinsics, boxes, image_index, self.config.network, self.model.diameter
        )

    def read(self, images: ImageFeatures, regions: Regions) -> PoseOutputs:
        """Pool the regions' features and crops and run the heads; nothing follows for regions that are not `valid`."""
        net = self.config.network
        rois = torch.cat([regions.image_index[:, None].to(regions.windows), regions.windows], 1)
        crops = None
        if net.crop_size:
            crops = depth_input.raw_crops(
                images.depth, images.normals, regions.windows, regions.reference_depth, regions.image_index,
                net.crop_size, self.model.diameter / 2,
            )  # fmt: skip
        with self._autocast():
            pooled = roi_align(images.features, rois, net.roi_size, 1.0 / self.backbone.stride)
            return self.heads(pooled, crops)

    @torch.no_grad()
    def propose(self, images: ImageFeatures, options: PredictOptions = AS_TRAINED) -> list[Proposals]:
        """For each image its detections, what is read off them, and the hypotheses that follow.

        The regions are read in portions, so that a large crowd needs no more memory than a small one.
        """
        per_image = self.detect(images, options.detection)
        index = torch.cat([torch.full_like(d.scores, i, dtype=torch.long) for i, d in enumerate(per_image)])
        boxes, scores = torch.cat([d.boxes for d in per_image]), torch.cat([d.scores for d in per_image])
        regions = self.regions(images, boxes, index)
        regions, scores = regions.select(regions.valid), scores[regions.valid]
        outputs, found = self._read_in_portions(images, regions, options)
        proposals = []
        for i in range(len(images.depth)):
            mine = regions.image_index == i
            rows = mine.nonzero()[:, 0]
            some = found.select(mine[found.detection])
            some = some.numbered((mine.cumsum(0) - 1)[some.detection])
            detections = Detections(regions.boxes[rows], scores[rows])
            seen = self.seen(images.features[i], images.intrinsics[i], some.rotation, some.center)
            proposals.append(Proposals(detections, outputs.select(rows), some, seen))
        return proposals

    def _read_in_portions(
        self, images: ImageFeatures, regions: Regions, options: PredictOptions
    ) -> tuple[PoseOutputs, Hypotheses]:
        trained = self.config.network.hypotheses
        per_detection = min(options.hypotheses or trained, trained)
        outputs, found = [], []
        rows = torch.arange(len(regions.valid), device=images.depth.device)
        for portion in rows.split(REGIONS_AT_ONCE):
            some = regions.select(portion)
            read = self.read(images, some)
            if not options.offset:
                read = read._replace(offset=torch.zeros_like(read.offset))
            part = hypotheses.generate(read, some, self.codec, self.distance, per_detection)
            outputs.append(read)
            found.append(part.numbered(portion[part.detection]))
        return PoseOutputs.joined(outputs), Hypotheses.joined(found)

    def seen(self, features: Tensor, intrinsics: Tensor, rotation: Tensor, center: Tensor) -> Tensor | None:
        """What the registration sees of each hypothesis (H, F): features (C, h, w) within the box of its object."""
        cells = self.config.network.registration_cells
        if self.registration is None or not cells:
            return None
        boxes = seen_boxes(self.outermost, rotation, center, intrinsics, nearest=0.1 * self.model.diameter)
        return pooled_features(features, boxes, cells, self.backbone.stride)

    def score(self, proposals: Proposals, options: PredictOptions = AS_TRAINED) -> Scored:
        """The logits of one image's hypotheses; gradients reach the scoring parameters only."""
        detections, outputs, found, seen = proposals
        confidence = self.confidence_logit(detections.scores, outputs, found)
        registered = self.registered_logit(confidence, found, seen) if options.registration else None
        return Scored(found, detections.boxes, confidence, registered)

    def confidence_logit(self, detected: Tensor, outputs: PoseOutputs, found: Hypotheses) -> Tensor:
        """The logits (H,) of hypotheses by themselves; `detected` (n,) are the scores of their detections."""
        if self.confidence is not None:
            return self.confidence(outputs.features, detected, found, self.model.diameter)
        product = detected[found.detection].clamp(1e-6, 1 - 1e-6).log() + found.log_product
        return product - torch.log1p(-product.exp().clamp(max=1 - 1e-6))

    def registered_logit(self, confidence: Tensor, found: Hypotheses, seen: Tensor | None) -> Tensor | None:
        """The logits (H,) of one image's hypotheses in view of each other; None without a registration."""
        if self.registration is None:
            return None
        angles = torch.stack(euler.to_angles(found.relative), -1)
        claims = HypothesisSet(confidence.detach(), found.rotation, found.center, angles, found.detection)
        neighbors = self.config.network.registration_neighbours
        return self.registration(relation_features(claims, self.model_box, neighbors), seen)

    def final_logit(self, confidence: Tensor, registered: Tensor | None) -> Tensor:
        """A learned confidence and the registration are two opinions; the paper's product is no opinion on its own."""
        if registered is None:
            return confidence
        return (confidence + registered) / 2 if self.confidence is not None else registered

    def rank(self, scored: Scored) -> ImagePoses:
        """The hypotheses by their final score, best first."""
        logit = self.final_logit(scored.confidence, scored.registered)
        order = logit.argsort(descending=True, stable=True)
        found = scored.hypotheses.select(order)
        boxes = scored.boxes[found.detection]
        return ImagePoses(found.rotation, found.center, logit[order].sigmoid(), boxes, found.detection)

    def _canonical_surface(self) -> NDArray[np.float64]:
        """Points (n, 3) of the object in its canonical frame."""
        surface = self.model.points if self.model.vertices is None else self.model.vertices
        assert surface is not None, "an object has a mesh or sampled points"
        return poses.apply(self.codec.canonical_from_obj, surface)

    @contextmanager
    def _autocast(self) -> Iterator[None]:
        """Only layers run in bf16: geometry never does."""
        device = next(self.parameters()).device.type
        with torch.autocast(device, dtype=torch.bfloat16, enabled=self.bf16):
            yield

    def while_scoring_learns(self) -> PredictOptions:
        """What the scores learn from: as in prediction, or with the duplicates that detection would drop."""
        overlap, own = self.config.train.scoring_overlap, self.detector.limits
        if overlap <= own.nms_iou:
            return AS_TRAINED
        return PredictOptions(detection=replace(own, nms_iou=overlap, least=2 * own.least))

    def _scoring_losses(self, images: ImageFeatures, batch: Batch) -> dict[str, Mean]:
        """Of the images that train the scores: the proposals are those of prediction, without dropout or gradient."""
        with self.predicting(self.bf16):
            proposals = self.propose(images, self.while_scoring_learns())
        scored = [self.score(image) for image in proposals]
        parts: dict[str, list[Tensor]] = {"confidence": [], "registration": []}
        with_any = torch.tensor([float(len(image.hypotheses) > 0) for image in scored]).sum()
        for image, truth, visibility in zip(scored, batch.poses, batch.visibility, strict=False):
            found = image.hypotheses
            rotation, center = self.codec.canonical(truth)
            distances = self.distance.between(found.rotation, found.center, rotation, center)
            if self.confidence is not None:
                right = (distances < self.model.threshold).any(1).float()
                loss = nn.functional.binary_cross_entropy_with_logits(image.confidence, right, reduction="sum")
                parts["confidence"].append(loss / max(len(found), 1))
            if image.registered is not None:
                ignored = visibility < self.config.train.min_visibility
                wanted = registration_targets(distances, image.confidence.detach(), self.model.threshold, ignored)
                weighting = self.config.loss.registration_weights
                parts["registration"].append(registration_loss(image.registered, wanted, weighting))
        return {name: Mean.of(torch.stack(values), with_any) for name, values in parts.items() if values}
