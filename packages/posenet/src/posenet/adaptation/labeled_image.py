"""An image with poses as labels, and the same scene as a camera sees it that is turned about its axis or zooms.

Few images are soon known by heart. Turned and zoomed they show their camera's errors on other pixels each time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from evalkit.geometry.camera import Camera
from posenet.layers.ops import box_area

LEAST_INSIDE = 0.5  # of a box; an instance whose box the frame cuts more is not learned from


@dataclass(frozen=True, eq=False)
class LabeledImage:
    """One image on the network's pixel grid, with n labels.

    Attributes:
        depth: (H, W) meters, 0 = no return.
        cam_from_obj: (n, 4, 4).
        outlines: n x (k, 2) points x, y around what is seen of each, in pixels from the image's corner.
        visibility: (n,), 0 of what is not to be learned.
    """

    depth: Tensor
    camera: Camera
    cam_from_obj: Tensor
    outlines: list[Tensor]
    visibility: Tensor

    @property
    def boxes(self) -> Tensor:
        """Visible boxes (n, 4), cut by the frame."""
        whole = self._whole_boxes()
        return whole.clamp(min=0).minimum(whole.new_tensor([self.camera.width, self.camera.height] * 2))

    @property
    def count(self) -> int:
        """How many instances are learned."""
        return int((self.visibility > 0).sum())

    @property
    def learned(self) -> Tensor:
        """The poses (m, 4, 4) that are learned."""
        return self.cam_from_obj[self.visibility > 0]

    def turned(self, angle: float, zoom: float = 1.0) -> LabeledImage:
        """The same scene as a camera sees it that is turned by `angle` radians about its axis, as if its pixels were
        `zoom` times as fine; what the camera did not see has no return."""
        old = self.camera
        cosine, sine = math.cos(angle), math.sin(angle)
        turn = torch.eye(4, dtype=torch.float64)
        turn[:2, :2] = torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)
        middle = torch.tensor([[old.width / 2, old.height / 2]], dtype=torch.float64)
        centered = Camera(old.width, old.height, zoom * old.fx, zoom * old.fy, 0.0, 0.0)
        x, y = (middle - _points(_rays(middle, old) @ turn[:2, :2].T, centered))[0].tolist()
        new = Camera(old.width, old.height, centered.fx, centered.fy, x, y)
        image = LabeledImage(
            self._seen_by(new, turn[:2, :2]),
            new,
            turn.to(self.cam_from_obj) @ self.cam_from_obj,
            [_points(_rays(points, old) @ turn[:2, :2].T, new) for points in self.outlines],
            self.visibility,
        )
        return image._without_cut_ones()

    def _seen_by(self, camera: Camera, turn: Tensor) -> Tensor:
        """Depth on another camera's pixels, the nearest of ours."""
        rows, columns = torch.meshgrid(
            torch.arange(camera.height).double() + 0.5, torch.arange(camera.width).double() + 0.5, indexing="ij"
        )
        here = _points(_rays(torch.stack([columns, rows], -1).view(-1, 2), camera) @ turn, self.camera)
        column, row = here.floor().long().unbind(-1)
        height, width = self.depth.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        depth = torch.where(inside, self.depth[row.clamp(0, height - 1), column.clamp(0, width - 1)], 0.0)
        return depth.view(camera.height, camera.width)

    def _whole_boxes(self) -> Tensor:
        found = [torch.cat([points.amin(0), points.amax(0)]) for points in self.outlines]
        return torch.stack(found).float() if found else torch.zeros(0, 4)

    def _without_cut_ones(self) -> LabeledImage:
        """The same without the labels of what lies beyond the frame; what the frame cuts is not to be learned."""
        whole, inside = (box_area(boxes) for boxes in (self._whole_boxes(), self.boxes))
        there = inside > 0
        visibility = torch.where(inside >= LEAST_INSIDE * whole, self.visibility, 0.0)
        outlines = [points for points, kept in zip(self.outlines, there.tolist(), strict=True) if kept]
        return LabeledImage(self.depth, self.camera, self.cam_from_obj[there], outlines, visibility[there])


def _rays(points: Tensor, camera: Camera) -> Tensor:
    """x/z, y/z (k, 2) through points (k, 2) in pixels from the image's corner; a pixel's center is half a pixel in."""
    return torch.stack([(points[:, 0] - 0.5 - camera.cx) / camera.fx, (points[:, 1] - 0.5 - camera.cy) / camera.fy], -1)


def _points(rays: Tensor, camera: Camera) -> Tensor:
    """The inverse of :func:`_rays`."""
    return torch.stack([rays[:, 0] * camera.fx + camera.cx + 0.5, rays[:, 1] * camera.fy + camera.cy + 0.5], -1)
