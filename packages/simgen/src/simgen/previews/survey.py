"""What a dataset holds, in numbers: visibility, depth, how many instances, and how they are turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]
CLEAR = 0.5  # geometric visibility from which an instance is to be found (Brégier et al. 2017)
STEPS = 1 << 16  # of stored depth


@dataclass(frozen=True, eq=False)
class Survey:
    """Labels are of all frames; pixels, and poses in the world, of `frames_read` frames of different scenes.

    Attributes:
        visibility: (M,) geometric, of every instance in every frame.
        instances: (scenes,) fallen into the bin.
        clear: (frames,) instances at least half visible.
        directions: (V, 3) of visible instances: unit vectors from the centroid to the camera, in the object's frame.
        axis_from_up: (K,) radians between the object's main axis and the world's z.
        depth_edges: (S + 1,) meters; `on_instances` and `elsewhere` (S,) are pixels, `no_return` a share of all pixels.
    """

    visibility: Array
    instances: NDArray[np.int64]
    clear: NDArray[np.int64]
    directions: Array
    axis_from_up: Array
    depth_edges: Array
    on_instances: NDArray[np.int64]
    elsewhere: NDArray[np.int64]
    no_return: float
    frames_read: int


def survey(dataset: ShardDataset, frames: list[int], bins: int = 60) -> Survey:
    """Look at all labels, and at the pixels of `frames`."""
    model = dataset.header.object
    labels = [reader.labels(frame) for reader, frame in map(dataset.locate, range(len(dataset)))]
    _, first = np.unique(dataset.scene_index, return_index=True)
    levels, axis_from_up, seen = np.zeros((2, STEPS), np.int64), [], set()
    for view in (dataset[frame] for frame in frames):
        levels += _depth_levels(view)
        if view.scene_index not in seen:
            seen.add(view.scene_index)
            axis_from_up.append(_axis_from_up(view, model))
    edges, counts = _rebinned(levels[:, 1:], bins)
    return Survey(
        visibility=np.concatenate([rows.visibility("geometric") for rows in labels]),
        instances=np.array([len(labels[frame]) for frame in first]),
        clear=np.array([(rows.visibility_geometric >= CLEAR).sum() for rows in labels]),
        directions=np.concatenate([_directions(rows, model) for rows in labels]),
        axis_from_up=np.concatenate(axis_from_up),
        depth_edges=edges * dataset.header.depth_unit,
        on_instances=counts[0],
        elsewhere=counts[1],
        no_return=float(levels[:, 0].sum() / levels.sum()),
        frames_read=len(frames),
    )


def _depth_levels(view: View) -> NDArray[np.int64]:
    """Pixels (2, STEPS) at each stored depth: on instances, and elsewhere."""
    inside = view.instance_id > 0
    return np.stack([np.bincount(view.depth_raw[mask], minlength=STEPS) for mask in (inside, ~inside)])


def _rebinned(levels: NDArray[np.int64], bins: int) -> tuple[Array, NDArray[np.int64]]:
    """Edges in steps, and counts (2, bins), from the nearest depth to where almost all pixels are."""
    total = levels.sum(0)
    if not total.any():
        return np.array([0.0, 1.0]), np.zeros((2, 1), np.int64)
    reached = np.cumsum(total) / total.sum()
    low, high = int(np.argmax(reached > 0)), int(np.argmax(reached >= 0.995)) + 1
    width = max(1, -(-(high - low) // bins))
    starts = np.arange(low, high, width)
    padded = np.pad(levels[:, low:high], ((0, 0), (0, len(starts) * width - (high - low))))
    edges = np.r_[starts, starts[-1] + width].astype(np.float64) + 1.0  # the level 0, no return, was left out
    return edges, padded.reshape(2, len(starts), width).sum(2)


def _directions(labels: Instances, model: ObjectModel) -> Array:
    shown = labels.cam_from_obj[labels.pixels_geometric > 0]
    obj_from_cam = poses.invert(shown)
    toward = obj_from_cam[:, :3, 3] - model.centroid
    return np.asarray(toward / np.linalg.norm(toward, axis=1, keepdims=True))


def _axis_from_up(view: View, model: ObjectModel) -> Array:
    world_from_obj = poses.invert(view.cam_from_world) @ view.instances.cam_from_obj
    return np.asarray(np.arccos(np.clip(world_from_obj[:, 2, :3] @ model.symmetry.axis, -1, 1)))
