"""The window of the image that a detection's pose is read from."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from posenet.config import NetworkConfig
from posenet.network.depth_input import median_depth


class Regions(NamedTuple):
    """R windows; `valid` is False where no depth returned inside the box, so that no pose can be read there."""

    boxes: Tensor  # (R, 4) what the windows are about, such as a detector's boxes
    windows: Tensor  # (R, 4) half-open pixel boxes
    image_index: Tensor  # (R,)
    reference_depth: Tensor  # (R,) meters
    intrinsics: Tensor  # (R, 4)
    valid: Tensor  # (R,) bool

    def select(self, rows: Tensor) -> Regions:
        return Regions(*(part[rows] for part in self))


def make_regions(
    depth: Tensor, intrinsics: Tensor, boxes: Tensor, image_index: Tensor, config: NetworkConfig, diameter: float
) -> Regions:
    """Windows for boxes (R, 4) on images (B, H, W).

    `box`: the box itself, as in Faster R-CNN. `metric`: a square about the box's center whose side is `roi_scale`
    diameters at the box's median depth, so that an object has one size in it whatever its distance and occlusion.
    """
    reference = median_depth(depth, boxes, image_index)
    valid = reference > 0
    intrinsics = intrinsics[image_index]
    if config.roi == "box":
        return Regions(boxes, boxes, image_index, reference, intrinsics, valid)
    sides = config.roi_scale * diameter * intrinsics[:, :2] / reference.clamp(min=0.05 * diameter)[:, None]
    centers = (boxes[:, :2] + boxes[:, 2:]) / 2
    windows = torch.cat([centers - sides / 2, centers + sides / 2], 1)
    return Regions(boxes, windows, image_index, reference, intrinsics, valid)
