"""Where in the image each hypothesis has its object: the box around the posed object, and the features within it."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from evalkit.objects.depth_views import sphere_directions
from posenet.layers.ops import roi_align

SIDES = 64  # from which the object's outermost points are looked for


def box_around(
    surface: NDArray[np.float64],  # (n, 3)
) -> Tensor:
    """Lowest and highest corner (2, 3) of a surface."""
    return torch.tensor(np.stack([surface.min(0), surface.max(0)]), dtype=torch.float32)


def outermost_points(
    surface: NDArray[np.float64],  # (n, 3)
) -> Tensor:
    """The points (at most SIDES, 3) of a surface that lie farthest to each side: they span its box in any pose."""
    rows = np.unique((surface @ sphere_directions(SIDES).T).argmax(0))
    return torch.tensor(surface[rows], dtype=torch.float32)


def seen_boxes(points: Tensor, rotation: Tensor, center: Tensor, intrinsics: Tensor, nearest: float) -> Tensor:
    """Half-open pixel boxes (n, 4) around points (P, 3) in poses given by rotation (n, 3, 3) and center (n, 3).

    `intrinsics` (4,) are fx, fy, cx, cy; points nearer than `nearest` meters are taken to be so far.
    """
    posed = points @ rotation.float().mT + center.float()[:, None]
    pixel = posed[..., :2] / posed[..., 2:].clamp(min=nearest) * intrinsics[:2] + intrinsics[2:]
    return torch.cat([pixel.amin(1), pixel.amax(1)], 1) + 0.5  # integer pixels are centers, boxes count from corners


def pooled_features(features: Tensor, boxes: Tensor, size: int, stride: int) -> Tensor:
    """Features (C, h, w) of one image within boxes (n, 4), on grids of `size`: (n, C * size * size)."""
    rois = torch.cat([torch.zeros_like(boxes[:, :1]), boxes], 1)
    return roi_align(features[None], rois, size, 1.0 / stride).flatten(1)
