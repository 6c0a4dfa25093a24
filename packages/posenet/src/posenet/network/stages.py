"""What the network's stages hand to each other: features, proposals, scored hypotheses, poses."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from posenet.detectors.base import Detections
from posenet.network.hypotheses import Hypotheses
from posenet.network.pose_heads import PoseOutputs


class ImagePoses(NamedTuple):
    """What the network says about one image: H hypotheses, best first."""

    rotation: Tensor  # (H, 3, 3) canonical object frame
    center: Tensor  # (H, 3) meters, centroid in the camera's frame
    score: Tensor  # (H,) in [0, 1]
    box: Tensor  # (H, 4) of the detection it comes from
    detection: Tensor  # (H,) number of that detection


class ImageFeatures(NamedTuple):
    """B images and what the trunk makes of them."""

    depth: Tensor  # (B, H, W) meters, 0 = no return
    intrinsics: Tensor  # (B, 4) fx, fy, cx, cy
    normals: Tensor  # (B, 3, H, W) of the surface, toward the camera
    features: Tensor  # (B, C, h, w)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images."""
        return self.depth.shape[-2], self.depth.shape[-1]

    def first(self, count: int) -> ImageFeatures:
        """The first `count` images, as constants without gradient."""
        return ImageFeatures(*(part[:count].detach() for part in self))


class Proposals(NamedTuple):
    """What is read off the n detections of one image, and the H hypotheses that follow."""

    detections: Detections
    outputs: PoseOutputs
    hypotheses: Hypotheses
    seen: Tensor | None = None  # (H, F) features within each hypothesis's own box, where the registration looks at them


class Scored(NamedTuple):
    """Hypotheses of one image on their way to a score."""

    hypotheses: Hypotheses
    boxes: Tensor  # (n, 4) of the detections
    confidence: Tensor  # (H,) logit before registration
    registered: Tensor | None  # (H,) logit after registration
