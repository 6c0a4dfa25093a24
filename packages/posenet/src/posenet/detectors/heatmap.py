"""A one-stage detector: a heatmap says which cells hold the center of an instance's box, and each cell says which box.

After CenterNet (Zhou et al. 2019, "Objects as Points"), with the box as distances to its sides as in FCOS (Tian
et al. 2019).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from posenet.detectors.base import DetectionLimits, Detections, Detector, thinned
from posenet.layers.mean import Mean
from posenet.layers.normalization import build_normalization
from posenet.layers.ops import clip_boxes

PRIOR = 0.1  # probability of a center that an untrained heatmap shows; RetinaNet's start, lest negatives swamp it
SPREAD = 0.1  # standard deviation of a target's bell, in sides of its box
LEAST_SPREAD = 0.6  # and in cells at least
REACH = 1  # cells around a center that learn its box
CANDIDATES = 4  # cells a detection that enter the suppression, at most


class HeatmapOutputs(NamedTuple):
    """Raw outputs on the grid of the features, float32."""

    logits: Tensor  # (B, h, w) of "a box's center lies in this cell"
    boxes: Tensor  # (B, h, w, 4) pixels
    image_size: tuple[int, int]  # height, width


class CenterTargets(NamedTuple):
    """What one image's heatmap should show."""

    bell: Tensor  # (h, w) 0..1, how near a center is; ignored instances included
    center: Tensor  # (h, w) bool, the cells that hold a center
    box: Tensor  # (h, w) index of the box that a cell learns
    learns_box: Tensor  # (h, w) bool


HEATMAP_LIMITS = DetectionLimits(min_score=0.1, nms_iou=0.65, least=64)


class HeatmapDetector(Detector):
    """Heatmap and box distances from one shared 3 x 3 layer.

    `object_size` (pixels) is what an instance's box usually measures: the unit of the regressed distances.
    """

    def __init__(
        self,
        channels: int,
        stride: int,
        object_size: float,
        *,
        limits: DetectionLimits = HEATMAP_LIMITS,
        box_weight: float = 0.5,
        norm: str = "batch",
    ) -> None:
        super().__init__()
        self.stride = stride
        self.object_size = object_size
        self.limits = limits
        self.box_weight = box_weight
        self.shared = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
            build_normalization(norm, channels),
            nn.ReLU(inplace=True),
        )
        self.heatmap = nn.Conv2d(channels, 1, 1)
        self.distances = nn.Conv2d(channels, 4, 1)
        self._initialize()

    def forward(self, features: Tensor, image_size: tuple[int, int]) -> HeatmapOutputs:
        shared = self.shared(features)
        logits = self.heatmap(shared).float()[:, 0]
        distances = self.distances(shared).float().permute(0, 2, 3, 1) * self.object_size
        centers = cell_centers(logits.shape[-2], logits.shape[-1], self.stride, logits.device)
        boxes = torch.cat([centers - distances[..., :2], centers + distances[..., 2:]], -1)
        return HeatmapOutputs(logits, boxes, image_size)

    def losses(
        self, raw: HeatmapOutputs, targets: list[Tensor], ignore: list[Tensor], draws: list[torch.Generator]
    ) -> dict[str, Mean]:
        """`heatmap`: penalty-reduced focal loss (CenterNet, eq. 1); `box`: L1 over the sides in object sizes."""
        grid = [
            center_targets(boxes.float(), ignored.float(), raw.logits.shape[-2:], self.stride)
            for boxes, ignored in zip(targets, ignore, strict=True)
        ]
        bell = torch.stack([image.bell for image in grid])
        center = torch.stack([image.center for image in grid])
        predicted = torch.cat([boxes[image.learns_box] for boxes, image in zip(raw.boxes, grid, strict=True)])
        wanted = torch.cat(
            [boxes.float()[image.box[image.learns_box]] for boxes, image in zip(targets, grid, strict=True)]
        )
        box = self.box_weight / self.object_size * F.l1_loss(predicted, wanted, reduction="sum")
        return {"heatmap": focal_loss(raw.logits, bell, center), "box": Mean.of(box, len(wanted))}

    @torch.no_grad()
    def detect(self, raw: HeatmapOutputs, limits: DetectionLimits | None = None) -> list[Detections]:
        """The surest cells, thinned by the overlap of their boxes.

        CenterNet keeps the local maxima of 3 x 3 cells instead. In a heap two visible boxes often have their centers in
        adjacent cells though their overlap is small: in 64 images of bins of 10-20 bunnies, after 8 minutes of
        training, that lost 3.5 % of the instances at least 20 % visible and 0.8 % of those half visible; this lost
        0.9 % and none.

        Long parts that cross have much the same box: of candlesticks at least half visible, 4.7 % overlap another by an
        IoU of 0.55, but 0.8 % by 0.65. Two boxes of one instance cost less: registration and refinement know them.
        """
        limits = limits or self.limits
        most = limits.most(raw.image_size)
        scores, cells = raw.logits.flatten(1).sigmoid().topk(min(CANDIDATES * most, raw.logits[0].numel()))
        boxes = raw.boxes.flatten(1, 2).gather(1, cells[..., None].expand(-1, -1, 4))
        boxes = clip_boxes(boxes, *raw.image_size)
        return [thinned(*image, limits, most) for image in zip(boxes, scores, strict=True)]

    def _initialize(self) -> None:
        nn.init.kaiming_normal_(self.shared[0].weight, nonlinearity="relu")  # type: ignore[arg-type]
        for head in (self.heatmap, self.distances):
            nn.init.normal_(head.weight, std=0.01)
        assert self.heatmap.bias is not None and self.distances.bias is not None
        nn.init.constant_(self.heatmap.bias, math.log(PRIOR / (1 - PRIOR)))
        nn.init.constant_(self.distances.bias, 0.5)


def cell_centers(height: int, width: int, stride: int, device: torch.device) -> Tensor:
    """Where the cells' centers (height, width, 2) lie: x, y in pixels of the input image."""
    y, x = torch.meshgrid(
        torch.arange(height, device=device) + 0.5, torch.arange(width, device=device) + 0.5, indexing="ij"
    )
    return torch.stack([x, y], -1) * stride


def center_targets(boxes: Tensor, ignored: Tensor, size: tuple[int, int] | torch.Size, stride: int) -> CenterTargets:
    """Targets of an image from its boxes (n, 4) and those to ignore (m, 4), on a grid of `size` (h, w).

    A cell learns the box whose center is nearest, of those within `REACH` cells. Where two boxes have their center in
    the same cell, the smaller is learned: it is more likely the one in front.
    """
    height, width = size
    everything = torch.cat([boxes, ignored])
    center = ((everything[:, :2] + everything[:, 2:]) / 2 / stride).floor()
    center = center.clamp(min=0).minimum(center.new_tensor([width - 1, height - 1]))
    side = (everything[:, 2:] - everything[:, :2]).clamp(min=0).prod(-1).sqrt() / stride
    sigma = (SPREAD * side).clamp(min=LEAST_SPREAD)
    rows = torch.arange(height, device=boxes.device)
    columns = torch.arange(width, device=boxes.device)
    dy, dx = rows[None, :, None] - center[:, 1, None, None], columns[None, None, :] - center[:, 0, None, None]
    squared = dy.square() + dx.square()  # (n + m, h, w)
    bell = torch.exp(-squared / (2 * sigma.square())[:, None, None])
    bell = torch.cat([bell.new_zeros(1, height, width), bell]).amax(0)
    return CenterTargets(bell, *_assigned(squared[: len(boxes)], side[: len(boxes)]))


def _assigned(squared: Tensor, side: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """From squared distances (n, h, w) to the centers: which cells are centers, whose box a cell learns, whether."""
    if len(squared) == 0:
        nothing = squared.new_zeros(squared.shape[1:])
        return nothing.bool(), nothing.long(), nothing.bool()
    tie_break = side / (side.max() + 1) / 2  # less than any difference between squared distances of whole cells
    nearest = (squared + tie_break[:, None, None]).argmin(0)
    distance = squared.amin(0)
    return distance == 0, nearest, distance <= 2 * REACH**2


def focal_loss(logits: Tensor, bell: Tensor, center: Tensor) -> Mean:
    """Penalty-reduced pixelwise focal loss with alpha = 2, beta = 4 (CenterNet, eq. 1), of (..., h, w), a center.

    An ignored instance lowers the penalty around its center as any other does, without being a positive.
    """
    probability = logits.sigmoid()
    positive = (1 - probability).square() * F.logsigmoid(logits)
    negative = (1 - bell).pow(4) * probability.square() * F.logsigmoid(-logits)
    return Mean.of(-torch.where(center, positive, negative), center.sum())
