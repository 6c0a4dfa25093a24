"""Faster R-CNN (Ren et al. 2015) for one class: a region proposal network, then a head that scores and refines.

Boxes are learned by L1, as the paper writes it, not smooth L1.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from posenet.detectors.base import DetectionLimits, Detections, Detector, thinned, wide_enough
from posenet.detectors.heatmap import cell_centers
from posenet.layers.mean import Mean
from posenet.layers.ops import box_iou, clip_boxes, decode_boxes, encode_boxes, nms, roi_align

POSITIVE, NEGATIVE, NEUTRAL = 1, 0, -1
RPN_LIMITS = DetectionLimits(min_score=0.05, nms_iou=0.5, least=64)
REFINEMENT_SCALE = (0.1, 0.1, 0.2, 0.2)  # Fast R-CNN's: refinements are small, so that they are learned in these units


class RpnOutputs(NamedTuple):
    """Raw outputs for the A anchors of every cell, N = h * w * A, float32."""

    features: Tensor  # (B, C, h, w)
    logits: Tensor  # (B, N) of "an instance, not the background"
    deltas: Tensor  # (B, N, 4) from anchor to box
    anchors: Tensor  # (N, 4) pixels
    image_size: tuple[int, int]  # height, width


class RpnDetector(Detector):
    """Both stages. `anchor_sizes` are square roots of areas in pixels, `anchor_ratios` heights over widths."""

    def __init__(
        self,
        channels: int,
        stride: int,
        anchor_sizes: tuple[float, ...],
        anchor_ratios: tuple[float, ...] = (0.5, 1.0, 2.0),
        *,
        hidden: int = 512,
        fc_width: int = 4096,
        dropout: float = 0.0,
        roi_size: int = 7,
        anchors_per_image: int = 256,
        rois_per_image: int = 128,
        candidates: int = 2000,
        proposals: int = 300,
        proposal_iou: float = 0.7,
        limits: DetectionLimits = RPN_LIMITS,
    ) -> None:
        """`candidates` enter the proposals' suppression at `proposal_iou`, `proposals` leave it at most.

        Both are of an image that may hold `limits.least` detections, and grow with that number.
        """
        super().__init__()
        self.stride = stride
        self.anchors_per_image = anchors_per_image
        self.rois_per_image = rois_per_image
        self.candidates = candidates
        self.proposals = proposals
        self.proposal_iou = proposal_iou
        self.limits = limits
        shapes = anchor_shapes(anchor_sizes, anchor_ratios)
        self.register_buffer("shapes", shapes, persistent=False)
        self.shared = nn.Sequential(nn.Conv2d(channels, hidden, 3, padding=1), nn.ReLU(inplace=True))
        self.objectness = nn.Conv2d(hidden, len(shapes), 1)
        self.deltas = nn.Conv2d(hidden, 4 * len(shapes), 1)
        self.box_head = BoxHead(channels, stride, roi_size, fc_width, dropout)
        nn.init.kaiming_normal_(self.shared[0].weight, nonlinearity="relu")  # type: ignore[arg-type]
        for head in (self.objectness, self.deltas):
            nn.init.normal_(head.weight, std=0.01)
            assert head.bias is not None
            nn.init.zeros_(head.bias)

    shapes: Tensor

    def forward(self, features: Tensor, image_size: tuple[int, int]) -> RpnOutputs:
        shared = self.shared(features)
        logits = self.objectness(shared).float().permute(0, 2, 3, 1).flatten(1)
        deltas = self.deltas(shared).float().permute(0, 2, 3, 1).reshape(len(features), -1, 4)
        centers = cell_centers(features.shape[2], features.shape[3], self.stride, features.device)
        return RpnOutputs(features, logits, deltas, anchors_at(centers, self.shapes), image_size)

    def losses(
        self, raw: RpnOutputs, targets: list[Tensor], ignore: list[Tensor], draws: list[torch.Generator]
    ) -> dict[str, Mean]:
        """`objectness` and `proposal` of the first stage, `score` and `refinement` of the second."""
        targets, ignore = [boxes.float() for boxes in targets], [boxes.float() for boxes in ignore]
        objectness, proposal = self._first_stage_losses(raw, targets, ignore, draws)
        score, refinement = self._second_stage_losses(raw, targets, ignore, draws)
        return {"objectness": objectness, "proposal": proposal, "score": score, "refinement": refinement}

    @torch.no_grad()
    def detect(self, raw: RpnOutputs, limits: DetectionLimits | None = None) -> list[Detections]:
        limits = limits or self.limits
        most = limits.most(raw.image_size)
        proposals = self.propose(raw, most / limits.least)
        logits, deltas = self.box_head(raw.features, proposals)
        found = []
        for boxes, logit, delta in zip(proposals, logits, deltas, strict=True):
            boxes = clip_boxes(decode_boxes(delta, boxes), *raw.image_size)
            found.append(thinned(boxes, logit.sigmoid(), limits, most))
        return found

    @torch.no_grad()
    def propose(self, raw: RpnOutputs, crowd: float = 1.0) -> list[Tensor]:
        """The first stage's best boxes (P, 4) of each image, P <= crowd * proposals, best first."""
        logits, index = raw.logits.topk(min(round(self.candidates * crowd), raw.logits.shape[1]))
        deltas = raw.deltas.gather(1, index[..., None].expand(-1, -1, 4))
        boxes = clip_boxes(decode_boxes(deltas, raw.anchors[index]), *raw.image_size)
        most = round(self.proposals * crowd)
        return [self._proposals_of(*image, most) for image in zip(boxes, logits, strict=True)]

    def _proposals_of(self, boxes: Tensor, logits: Tensor, most: int) -> Tensor:
        usable = wide_enough(boxes)
        boxes, logits = boxes[usable], logits[usable]
        return boxes[nms(boxes, logits, self.proposal_iou)[:most]]

    def _first_stage_losses(
        self, raw: RpnOutputs, targets: list[Tensor], ignore: list[Tensor], draws: list[torch.Generator]
    ) -> tuple[Mean, Mean]:
        samples = []
        for boxes, ignored, draw in zip(targets, ignore, draws, strict=True):
            labels, match = label_anchors(raw.anchors, boxes, ignored)
            chosen = sample(labels, self.anchors_per_image, 0.5, draw)
            samples.append(Sample(chosen, labels[chosen], match[chosen]))
        logits = [logit[s.chosen] for logit, s in zip(raw.logits, samples, strict=True)]
        deltas = [delta[s.chosen] for delta, s in zip(raw.deltas, samples, strict=True)]
        anchors = [raw.anchors[s.chosen] for s in samples]
        return stage_losses(logits, deltas, anchors, samples, targets)

    def _second_stage_losses(
        self, raw: RpnOutputs, targets: list[Tensor], ignore: list[Tensor], draws: list[torch.Generator]
    ) -> tuple[Mean, Mean]:
        samples, rois = [], []
        for proposals, boxes, ignored, draw in zip(self.propose(raw), targets, ignore, draws, strict=True):
            candidates = torch.cat([boxes, proposals])  # the truth too, so that the head learns before the proposals do
            labels, match, hard = label_rois(candidates, boxes, ignored)
            chosen = sample(labels, self.rois_per_image, 0.25, draw, preferred=hard)
            samples.append(Sample(chosen, labels[chosen], match[chosen]))
            rois.append(candidates[chosen])
        logits, deltas = self.box_head(raw.features, rois)
        return stage_losses(logits, deltas, rois, samples, targets, self.box_head.scale)


class BoxHead(nn.Module):
    """The second stage: two fully connected layers over the pooled features, a score and a refinement (Fast R-CNN)."""

    scale: Tensor

    def __init__(self, channels: int, stride: int, roi_size: int, width: int, dropout: float) -> None:
        super().__init__()
        self.stride = stride
        self.roi_size = roi_size
        self.trunk = nn.Sequential(
            nn.Flatten(),
            nn.Linear(channels * roi_size**2, width),
            nn.ReLU(inplace=True),
            nn.Dropout(dropout),
            nn.Linear(width, width),
            nn.ReLU(inplace=True),
            nn.Dropout(dropout),
        )
        self.score = nn.Linear(width, 1)
        self.deltas = nn.Linear(width, 4)
        self.register_buffer("scale", torch.tensor(REFINEMENT_SCALE), persistent=False)
        for module in self.trunk:
            if isinstance(module, nn.Linear):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)
        for head, std in ((self.score, 0.01), (self.deltas, 0.001)):
            nn.init.normal_(head.weight, std=std)
            nn.init.zeros_(head.bias)

    def forward(self, features: Tensor, boxes: list[Tensor]) -> tuple[list[Tensor], list[Tensor]]:
        """Boxes (n, 4) of each image to logits (n,) and deltas (n, 4) of each, float32."""
        index = torch.cat([box.new_full((box.shape[0], 1), image) for image, box in enumerate(boxes)])
        rois = torch.cat([index, torch.cat(boxes)], 1)
        hidden = self.trunk(roi_align(features, rois, self.roi_size, 1 / self.stride))
        counts = [box.shape[0] for box in boxes]
        logits = self.score(hidden).float()[:, 0].split(counts)
        deltas = (self.deltas(hidden).float() * self.scale).split(counts)
        return list(logits), list(deltas)


class Sample(NamedTuple):
    """The rows of one image that a loss looks at."""

    chosen: Tensor  # (n,) indices
    labels: Tensor  # (n,) POSITIVE or NEGATIVE
    match: Tensor  # (n,) index of the target that each overlaps most


def anchor_shapes(sizes: tuple[float, ...], ratios: tuple[float, ...]) -> Tensor:
    """Half-widths and half-heights (len(sizes) * len(ratios), 2); sizes² are areas, ratios are height / width."""
    half = [(size / ratio**0.5 / 2, size * ratio**0.5 / 2) for size in sizes for ratio in ratios]
    return torch.tensor(half)


def anchors_at(centers: Tensor, shapes: Tensor) -> Tensor:
    """Anchors (h * w * A, 4) of all shapes (A, 2) at each of the cells' centers (h, w, 2)."""
    low, high = centers[:, :, None] - shapes, centers[:, :, None] + shapes
    return torch.cat([low, high], -1).view(-1, 4)


def label_anchors(anchors: Tensor, boxes: Tensor, ignored: Tensor) -> tuple[Tensor, Tensor]:
    """Labels (N,) of anchors (N, 4) and the box (N,) that each is to become (Faster R-CNN, section 3.1.2).

    Positive from an IoU of 0.7, or as the best of a box; negative below 0.3 with every box, ignored ones included.
    """
    overlap, match = _best_overlap(anchors, boxes)
    labels = torch.full_like(match, NEUTRAL)
    labels[(overlap < 0.3) & (_best_overlap(anchors, ignored)[0] < 0.3)] = NEGATIVE
    labels[overlap >= 0.7] = POSITIVE
    if len(boxes):
        pairs = box_iou(anchors, boxes)
        best = pairs.amax(0)
        row, box = ((pairs == best) & (best > 0)).nonzero(as_tuple=True)
        labels[row], match[row] = POSITIVE, box
    return labels, match


def label_rois(rois: Tensor, boxes: Tensor, ignored: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Labels (N,) of regions (N, 4), the box (N,) of each, and which negatives are hard (N,) (Fast R-CNN, section 2.3).

    Positive from an IoU of 0.5; negative below it, hard from 0.1; neutral where an ignored box overlaps by 0.3 or more
    and the region is not positive.
    """
    overlap, match = _best_overlap(rois, boxes)
    labels = torch.full_like(match, NEGATIVE)
    labels[_best_overlap(rois, ignored)[0] >= 0.3] = NEUTRAL
    labels[overlap >= 0.5] = POSITIVE
    return labels, match, (labels == NEGATIVE) & (overlap >= 0.1)


def _best_overlap(candidates: Tensor, boxes: Tensor) -> tuple[Tensor, Tensor]:
    """The largest IoU (N,) of each candidate with any box, and that box's index (N,); 0 where there is none."""
    if len(boxes) == 0:
        return candidates.new_zeros(len(candidates)), torch.zeros_like(candidates[:, 0], dtype=torch.long)
    overlap, match = box_iou(candidates, boxes).max(1)
    return overlap, match


def sample(
    labels: Tensor, count: int, positive_share: float, draw: torch.Generator, preferred: Tensor | None = None
) -> Tensor:
    """Indices of at most `count` rows, at random: positives up to their share, then negatives.

    Among the negatives the `preferred` (N,) bool come first; the rest only fill up.
    """
    positive = _shuffled((labels == POSITIVE).nonzero()[:, 0], draw)[: int(count * positive_share)]
    negative = _shuffled((labels == NEGATIVE).nonzero()[:, 0], draw)
    if preferred is not None:
        negative = torch.cat([negative[preferred[negative]], negative[~preferred[negative]]])
    return torch.cat([positive, negative[: count - len(positive)]])


def _shuffled(index: Tensor, draw: torch.Generator) -> Tensor:
    return index[torch.randperm(len(index), generator=draw).to(index.device)]


def stage_losses(
    logits: list[Tensor],
    deltas: list[Tensor],
    anchors: list[Tensor],
    samples: list[Sample],
    targets: list[Tensor],
    scale: Tensor | None = None,
) -> tuple[Mean, Mean]:
    """Cross-entropy of the scores, and L1 of the positives' deltas (in units of `scale`), both per sampled row."""
    labels = torch.cat([s.labels for s in samples])
    score = F.binary_cross_entropy_with_logits(torch.cat(logits), labels.float(), reduction="sum")
    wanted = torch.cat(
        [encode_boxes(boxes[s.match[s.labels == POSITIVE]], anchor[s.labels == POSITIVE])
         for boxes, anchor, s in zip(targets, anchors, samples, strict=True)]
    )  # fmt: skip
    error = (torch.cat(deltas)[labels == POSITIVE] - wanted).abs()
    return Mean.of(score, len(labels)), Mean.of(error if scale is None else error / scale, len(labels))
