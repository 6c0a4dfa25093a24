"""What any detector of the network is: features in; losses, or scored boxes, out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from posenet.layers.mean import Mean
from posenet.layers.ops import nms

LEAST_SIDE = 1.0  # pixels; a box thinner than this is dropped


class Detections(NamedTuple):
    """Scored boxes of one image, best first."""

    boxes: Tensor  # (K, 4) x0, y0, x1, y1 in pixels of the input image
    scores: Tensor  # (K,) probability that the box holds an instance


@dataclass(frozen=True)
class DetectionLimits:
    """Which boxes are detections, and how many of them an image may hold."""

    min_score: float  # less is no detection
    nms_iou: float  # of two boxes that overlap by more the worse is dropped
    least: int  # every image may hold so many
    density: float = 0.0  # and as many as this a pixel, if that is more

    def most(self, image_size: tuple[int, int]) -> int:
        """The most detections of an image of `image_size` (height, width)."""
        return max(self.least, math.ceil(self.density * image_size[0] * image_size[1]))


class Detector(nn.Module, ABC):
    """Finds the boxes of instances of the one object that the network knows.

    `forward` gives raw outputs, of a type of the detector's own, that `losses` and `detect` take. An *ignored* box is
    an instance too hidden to be asked for: finding it is neither rewarded nor punished.
    """

    limits: DetectionLimits

    @abstractmethod
    def forward(self, features: Tensor, image_size: tuple[int, int]) -> Any:
        """Raw outputs from features (B, C, h, w) of images of `image_size` (height, width)."""

    @abstractmethod
    def losses(
        self, raw: Any, targets: list[Tensor], ignore: list[Tensor], draws: list[torch.Generator]
    ) -> dict[str, Mean]:
        """Named losses whose sum is to be minimized; per image boxes (n, 4) to find and boxes (m, 4) to ignore.

        What is left to chance in an image is drawn from its generator (on the CPU) among `draws`. Images without any
        instance are taken. Every parameter takes part, if only with a gradient of zero.
        """

    @abstractmethod
    def detect(self, raw: Any, limits: DetectionLimits | None = None) -> list[Detections]:
        """What is found in each image, within `limits` (None: the detector's own); without gradient."""


def thinned(boxes: Tensor, scores: Tensor, limits: DetectionLimits, most: int) -> Detections:
    """Of one image's boxes (n, 4) with scores (n,) the detections: sure enough, each instance once, `most` of them."""
    usable = (scores >= limits.min_score) & wide_enough(boxes)
    boxes, scores = boxes[usable], scores[usable]
    kept = nms(boxes, scores, limits.nms_iou)[:most]
    return Detections(boxes[kept], scores[kept])


def wide_enough(boxes: Tensor) -> Tensor:
    """Which boxes (n, 4) have sides at all."""
    return ((boxes[:, 2:] - boxes[:, :2]) >= LEAST_SIDE).all(-1)
