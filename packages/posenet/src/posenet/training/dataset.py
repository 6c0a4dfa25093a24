"""Frames of shards as training batches; which scenes train and which validate; in which order."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.datasets.shard_reader import ShardReader
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.network.depth_input import intrinsics_of, resample
from posenet.network.targets import Batch

LEAST_SCENES = 4


@dataclass(frozen=True, eq=False)
class Split:
    """Frame numbers of a dataset that train, and those that validate; no scene is in both."""

    train: NDArray[np.int64]
    validation: NDArray[np.int64]


class Frames:
    """A :class:`ShardDataset` as the network wants it, on the pixel grid of `camera`: the shards' own at first."""

    def __init__(self, source: Path | str | list[Path]) -> None:
        self.dataset = ShardDataset(source)
        if len(self.dataset) == 0:
            raise InputError(f"{source}: the shards hold no frames; build some with 'simgen build'.")
        self.camera = self.stored_camera

    @property
    def stored_camera(self) -> Camera:
        """The camera of the images as they lie in the shards."""
        return self.dataset.header.camera

    @property
    def model(self) -> ObjectModel:
        return self.dataset.header.object

    @property
    def sensor(self) -> str | None:
        """The camera whose errors the shards' depth has; None for ideal depth."""
        sensor = self.dataset.header.config.get("sensor")
        return str(sensor.get("model", "some")) if isinstance(sensor, dict) else None

    def on_grid_of(self, camera: Camera) -> Frames:
        """The same frames as images of another camera of the same views."""
        other = copy(self)
        other.camera = camera
        return other

    def split(self, validation_share: float, seed: int, most_images: int) -> Split:
        """Hold out a share of the scenes, at least one; validate on at most `most_images` of their frames.

        Raises:
            InputError: there are too few scenes to hold any out.
        """
        scene_of = self.dataset.scene_index
        scenes = np.unique(scene_of)
        if validation_share <= 0:
            return Split(np.arange(len(scene_of)), np.arange(0))
        if len(scenes) < LEAST_SCENES:
            raise InputError(
                f"the shards hold {len(scenes)} scenes, and at least {LEAST_SCENES} are needed to hold some out for "
                "validation; build more scenes, or give --no-validation."
            )
        rng = np.random.default_rng([seed, 1])
        held_out = rng.choice(scenes, max(1, round(validation_share * len(scenes))), replace=False)
        is_held_out = np.isin(scene_of, held_out)
        validation = np.flatnonzero(is_held_out)
        picked = np.linspace(0, len(validation) - 1, min(most_images, len(validation))).round().astype(int)
        return Split(np.flatnonzero(~is_held_out), validation[picked])

    def batch(self, frames: NDArray[np.int64], seeds: tuple[int, ...] | None = None) -> Batch:
        """The frames' images and labels; `seeds` (one a frame) decide what a training step leaves to chance."""
        located = [self.dataset.locate(int(frame)) for frame in frames]
        labels = [reader.labels(number) for reader, number in located]
        return Batch(
            depth=torch.stack([self._depth(*location) for location in located]),
            intrinsics=intrinsics_of(self.camera).expand(len(located), 4),
            poses=[torch.from_numpy(part.cam_from_obj).float() for part in labels],
            boxes=[torch.from_numpy(part.box_returned * self._box_scale).float() for part in labels],
            visibility=[torch.from_numpy(part.visibility_returned) for part in labels],
            seeds=seeds if seeds is not None else step_seeds(0, 0, frames),
        )

    def _depth(self, reader: ShardReader, number: int) -> torch.Tensor:
        depth = torch.from_numpy(reader.depth_raw(number) * np.float32(self.dataset.header.depth_unit))
        return resample(depth, self.camera)

    @property
    def _box_scale(self) -> NDArray[np.float64]:
        """On x0, y0, x1, y1 in the shards."""
        stored = self.stored_camera
        return np.tile([self.camera.width / stored.width, self.camera.height / stored.height], 2)

    def depths(self, frames: NDArray[np.int64], min_visibility: float, most: int = 2000) -> NDArray[np.float64]:
        """Depth in meters of the centroid of each instance that trains, in up to `most` of the frames.

        Raises:
            InputError: no instance is visible enough to train on.
        """
        picked = frames[np.linspace(0, len(frames) - 1, min(most, len(frames))).round().astype(int)]
        depths = []
        for frame in picked:
            reader, number = self.dataset.locate(int(frame))
            labels = reader.labels(number)
            seen = labels.cam_from_obj[labels.visibility_returned >= min_visibility]
            depths.append(self.model.centers(seen)[:, 2])
        found = np.concatenate(depths)
        if len(found) == 0:
            raise InputError(
                f"no instance in the shards is at least {min_visibility:.0%} visible, so there is nothing to train on; "
                "check the shards with 'simgen preview'."
            )
        return found


def epoch_order(frames: NDArray[np.int64], seed: int, epoch: int) -> NDArray[np.int64]:
    """The order of an epoch: the same for a seed and an epoch, so that a resumed run sees what an unbroken one does."""
    return np.random.default_rng([seed, 2, epoch]).permutation(frames)


def step_seeds(seed: int, step: int, frames: NDArray[np.int64]) -> tuple[int, ...]:
    """A seed (63 bits) for each image of a step: whatever shares the batch or came before, its draws are the same."""
    words = [
        np.random.SeedSequence(seed, spawn_key=(4, step, int(frame))).generate_state(1, np.uint64) for frame in frames
    ]
    return tuple(int(word[0] >> np.uint64(1)) for word in words)
