"""From labeled frames to what one training step learns from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from posenet.config import TrainConfig


class Batch(NamedTuple):
    """B images of one size with their instances."""

    depth: Tensor  # (B, H, W) meters, 0 = no return
    intrinsics: Tensor  # (B, 4) fx, fy, cx, cy
    poses: list[Tensor]  # B x (n, 4, 4) cam_from_obj
    boxes: list[Tensor]  # B x (n, 4) around the pixels with a return
    visibility: list[Tensor]  # B x (n,) returned share
    seeds: tuple[int, ...]  # of what is left to chance in each image

    def to(self, device: torch.device) -> Batch:
        return self.packed().unpacked(device)

    def packed(self) -> PackedBatch:
        """The same as a handful of arrays."""
        poses, boxes, visibility = (torch.cat(part).numpy() for part in (self.poses, self.boxes, self.visibility))
        counts = tuple(len(part) for part in self.boxes)
        return PackedBatch(self.depth.numpy(), self.intrinsics.numpy(), poses, boxes, visibility, counts, self.seeds)

    def draws(self) -> list[torch.Generator]:
        """A fresh generator an image, on the CPU: a seed gives the same draws on every device and in any company."""
        return [torch.Generator().manual_seed(seed) for seed in self.seeds]


class PackedBatch(NamedTuple):
    """A :class:`Batch` as few arrays, which travel between processes and to a GPU in little time."""

    depth: NDArray[np.float32]  # (B, H, W)
    intrinsics: NDArray[np.float32]  # (B, 4)
    poses: NDArray[np.float32]  # (N, 4, 4) of all images, one after the other
    boxes: NDArray[np.float32]  # (N, 4)
    visibility: NDArray[np.float32]  # (N,)
    counts: tuple[int, ...]  # instances of each image
    seeds: tuple[int, ...]

    def unpacked(self, device: torch.device) -> Batch:
        """The batch, its tensors on `device`."""
        depth, intrinsics, *lists = (torch.from_numpy(part).to(device) for part in self[:5])
        poses, boxes, visibility = (list(part.split(self.counts)) for part in lists)
        return Batch(depth, intrinsics, poses, boxes, visibility, self.seeds)


class RegionSample(NamedTuple):
    """R regions to learn poses from."""

    boxes: Tensor  # (R, 4) jittered visible boxes
    image_index: Tensor  # (R,)
    poses: Tensor  # (R, 4, 4) cam_from_obj


def detection_targets(batch: Batch, min_visibility: float) -> tuple[list[Tensor], list[Tensor]]:
    """Boxes to find, and boxes that are neither object nor background, of each image."""
    wanted = [visibility >= min_visibility for visibility in batch.visibility]
    seen = [(boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1]) for boxes in batch.boxes]
    find = [boxes[want & see] for boxes, want, see in zip(batch.boxes, wanted, seen, strict=True)]
    ignore = [boxes[~want & see] for boxes, want, see in zip(batch.boxes, wanted, seen, strict=True)]
    return find, ignore


def reference_shift(draws: list[torch.Generator], largest: float) -> Tensor:
    """By how much (B,) each image is shown about another depth than its own: half of them, up to `largest`."""
    if largest == 0:
        return torch.zeros(len(draws))
    shift = torch.cat([torch.rand(1, generator=draw) for draw in draws]) * 4 - 2  # beyond -1 .. 1: as it is
    return torch.where(shift.abs() <= 1, shift * largest, 0.0)


def sample_regions(batch: Batch, config: TrainConfig, draws: list[torch.Generator]) -> RegionSample:
    """At most `rois_per_image` instances of each image, at random, with boxes as inexact as a detector's."""
    boxes, index, instance_poses = [], [], []
    images = zip(batch.boxes, batch.visibility, batch.poses, draws, strict=True)
    for i, (box, visibility, pose, draw) in enumerate(images):
        usable = ((visibility >= config.min_visibility) & (box[:, 2] > box[:, 0])).nonzero()[:, 0]
        order = torch.randperm(len(usable), generator=draw)[: config.rois_per_image]
        chosen = usable[order.to(usable.device)]
        boxes.append(jitter(box[chosen], config.box_jitter, draw))
        index.append(torch.full((len(chosen),), i, device=box.device))
        instance_poses.append(pose[chosen])
    return RegionSample(torch.cat(boxes), torch.cat(index), torch.cat(instance_poses))


def jitter(boxes: Tensor, amount: float, draw: torch.Generator) -> Tensor:
    """Boxes (n, 4) with each edge moved by up to `amount` of the box's side, at least one pixel wide."""
    sides = (boxes[:, 2:] - boxes[:, :2]).repeat(1, 2)
    moved = boxes + (torch.rand(boxes.shape, generator=draw).to(boxes) * 2 - 1) * amount * sides
    return torch.cat([moved[:, :2], torch.maximum(moved[:, 2:], moved[:, :2] + 1.0)], 1)
