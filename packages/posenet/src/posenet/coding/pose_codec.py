"""Between poses and what the heads predict: center offset, depth bin, three angle bins.

Every question that the paper leaves open about labels is decided here:

* The network works in a *canonical* object frame: origin at the object's centroid, symmetry axis along z. Poses in and
  out of this package stay in the mesh's own frame; the model file carries `obj_from_canonical`.
* The three angles are those of :mod:`posenet.coding.euler`: 30 bins of the in-plane angle a, 13 of the tilt b, 30 of
  the spin c about the object's z. Under a revolution c is not estimated; under a sphere no angle is.
* Finite symmetries: of all equivalent poses the one with the smallest tilt is the label, and c counts modulo
  2 pi / (number of symmetries about z). So the 30 bins of c cover one period, and b ends at pi / 2 where the symmetry
  turns z upside down: equivalent poses have one label, and bins are as fine as the symmetry allows.
* Depth is that of the centroid, in 140 bins over the training set's range (absolute) or about the median depth of the
  region (relative). The offset runs from the region's center to the centroid's projection, in units of its sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from posenet.coding import euler
from posenet.coding.class_bins import Bins
from posenet.config import NetworkConfig


class PoseLabels(NamedTuple):
    """Targets of n regions (the codec's units)."""

    offset: Tensor  # (n, 2) in sides of the region
    depth: Tensor  # (n,) meters: of the centroid, absolute or relative to the region's median
    angles: Tensor  # (n, 3) radians: a, b, c
    rotation: Tensor  # (n, 3, 3) relative to the ray (or the camera), canonical object frame


@dataclass(frozen=True, eq=False)
class PoseCodec:
    """Encodes poses as labels of a region and decodes predictions into poses. Stateless; all methods batch first."""

    model: ObjectModel
    config: NetworkConfig
    depth_range: tuple[float, float]  # meters: centroid depths of the training set

    @property
    def obj_from_canonical(self) -> NDArray[np.float64]:
        """(4, 4): origin at the centroid, z along the symmetry axis."""
        return poses.from_rotation_translation(self.model.symmetry.obj_from_sym, self.model.centroid)

    @property
    def canonical_from_obj(self) -> NDArray[np.float64]:
        return poses.invert(self.obj_from_canonical)

    @property
    def estimates_spin(self) -> bool:
        return self.model.symmetry.kind == "finite"

    @property
    def estimates_tilt(self) -> bool:
        return self.model.symmetry.kind != "sphere"

    @property
    def angle_bins(self) -> tuple[Bins, Bins, Bins]:
        """Bins of a, b and c; those of an angle that the symmetry makes meaningless have count 1."""
        count_a, count_b, count_c = self.config.angle_bins
        symmetry = self.model.symmetry
        turns_over = bool((symmetry.rotations @ symmetry.axis @ symmetry.axis < -1 + 1e-6).any())
        return (
            Bins(count_a if self.estimates_tilt else 1, 0.0, 2 * math.pi, circular=True),
            Bins(count_b if self.estimates_tilt else 1, 0.0, math.pi / 2 if turns_over else math.pi),
            Bins(count_c if self.estimates_spin else 1, 0.0, 2 * math.pi / symmetry.fold, circular=True),
        )

    @property
    def depth_bins(self) -> Bins:
        if self.config.depth == "relative":
            half = self.config.depth_margin * self.model.diameter
            return Bins(self.config.depth_bins, -half, half)
        low, high = self.depth_range
        margin = self.config.depth_margin * max(high - low, self.model.diameter)
        return Bins(self.config.depth_bins, max(low - margin, 0.0), high + margin)

    def canonical(self, cam_from_obj: Tensor) -> tuple[Tensor, Tensor]:
        """Poses (..., 4, 4) of the object's frame to canonical rotations (..., 3, 3) and centroids (..., 3)."""
        frame = torch.as_tensor(self.obj_from_canonical, dtype=cam_from_obj.dtype, device=cam_from_obj.device)
        pose = cam_from_obj @ frame
        return pose[..., :3, :3], pose[..., :3, 3]

    def cam_from_obj(self, rotation: Tensor, center: Tensor) -> NDArray[np.float64]:
        """Canonical rotations (..., 3, 3) and centroids (..., 3) to float64 poses (..., 4, 4) of the object's frame."""
        exact = poses.nearest_rotation(rotation.detach().double().cpu().numpy())
        pose = poses.from_rotation_translation(exact, center.detach().double().cpu().numpy())
        return pose @ self.canonical_from_obj

    def ray(self, center: Tensor) -> Tensor:
        """What rotations are relative to, for centroids (..., 3): the ray, or the camera if egocentric."""
        if self.config.orientation == "egocentric":
            return torch.eye(3, dtype=center.dtype, device=center.device).expand(*center.shape[:-1], 3, 3)
        return euler.ray_rotation(center)

    def canonical_label(self, rotation: Tensor) -> Tensor:
        """Of all rotations equivalent to `rotation` (..., 3, 3), ray frame, the one with the smallest tilt."""
        group = torch.as_tensor(self.model.symmetry.rotated(self.canonical_from_obj[:3, :3]).rotations)
        candidates = rotation[..., None, :, :] @ group.to(rotation)
        tilt_cosine = candidates[..., 2, 2]
        # Turns about z leave the tilt alone: take the first of nearly equal ones, so that rounding does not choose.
        best = (tilt_cosine > tilt_cosine.amax(-1, keepdim=True) - 1e-6).int().argmax(-1)
        index = best[..., None, None, None].expand(*best.shape, 1, 3, 3)
        return candidates.gather(-3, index)[..., 0, :, :]

    def encode(self, cam_from_obj: Tensor, windows: Tensor, reference_depth: Tensor, intrinsics: Tensor) -> PoseLabels:
        """Labels of n regions.

        Args:
            cam_from_obj: (n, 4, 4) the pose of each region's instance.
            windows: (n, 4) x0, y0, x1, y1 of the regions, pixels.
            reference_depth: (n,) median depth of each region, meters.
            intrinsics: (n, 4) fx, fy, cx, cy.
        """
        rotation, center = self.canonical(cam_from_obj)
        relative = self.canonical_label(self.ray(center).transpose(-1, -2) @ rotation)
        projected = center[..., :2] / center[..., 2:] * intrinsics[..., :2] + intrinsics[..., 2:]
        sides = windows[..., 2:] - windows[..., :2]
        offset = (projected - window_centers(windows)) / sides
        depth = center[..., 2] - (reference_depth if self.config.depth == "relative" else 0.0)
        return PoseLabels(offset, depth, torch.stack(euler.to_angles(relative), -1), relative)

    def decode(
        self,
        offset: Tensor,
        depth: Tensor,
        relative: Tensor,
        windows: Tensor,
        reference_depth: Tensor,
        intrinsics: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The inverse of :meth:`encode`, up to symmetry.

        Args:
            offset: (..., 2), depth: (...), relative: (..., 3, 3) rotations in the ray frame.
            windows, reference_depth, intrinsics: as in :meth:`encode`, broadcastable.

        Returns:
            Canonical rotations (..., 3, 3) and centroids (..., 3) in the camera's frame.
        """
        sides = windows[..., 2:] - windows[..., :2]
        pixel = window_centers(windows) + offset * sides
        z = depth + (reference_depth if self.config.depth == "relative" else 0.0)
        z = z.clamp(min=1e-3 * self.model.diameter)
        xy = (pixel - intrinsics[..., 2:]) / intrinsics[..., :2] * z[..., None]
        center = torch.cat([xy, z[..., None]], -1)
        return self.ray(center) @ relative, center


def window_centers(windows: Tensor) -> Tensor:
    """Centers (..., 2), in pixel coordinates, of half-open windows (..., 4): integer u is a pixel's center."""
    return (windows[..., :2] + windows[..., 2:]) / 2 - 0.5
