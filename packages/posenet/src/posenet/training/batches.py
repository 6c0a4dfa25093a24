"""The batches of a run: which frames each step trains on, what is drawn for them, how they are cut and degraded.

All of it follows from the seed and the number of the step, so a resumed run sees what an unbroken one does.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from posenet.augmentation.depth_errors import Degradation, degrade, generator_of
from posenet.augmentation.framing import frame_size, framed
from posenet.config import TrainConfig
from posenet.network.targets import Batch, PackedBatch
from posenet.training.dataset import Frames, epoch_order, step_seeds
from posenet.training.prefetch import Prefetch
from posenet.training.rank import Rank

MOST_WORKERS = 12  # processes that make batches for a GPU


class Batches:
    """The batches of the `train` frames (n,) of `frames`, and this rank's share of each."""

    def __init__(self, frames: Frames, train: NDArray[np.int64], config: TrainConfig, seed: int, rank: Rank) -> None:
        self.frames, self.train, self.config, self.seed, self.rank = frames, train, config, seed, rank
        self.degradation = degradation_of(config, frames)
        self._ahead: Prefetch[PackedBatch] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_ahead": None}

    @property
    def steps_per_epoch(self) -> int:
        return max(1, len(self.train) // self.config.batch_images)

    def frame_numbers(self, step: int) -> NDArray[np.int64]:
        """The frames of a step, of all ranks together."""
        size = min(self.config.batch_images, len(self.train))
        epoch, position = divmod(step, self.steps_per_epoch)
        return epoch_order(self.train, self.seed, epoch)[position * size : (position + 1) * size]

    def load(self, step: int, device: torch.device) -> Batch:
        """This rank's share of a step's batch, on `device`, cut and degraded where the configuration says so.

        A GPU takes its steps faster than a core reads and degrades images, so for one other processes make the next
        batches meanwhile.
        """
        torch.manual_seed(step_seeds(self.seed, step, np.array([self.rank.index]))[0])  # dropout draws globally
        if device.type == "cpu":
            return self._made(step)
        if self._ahead is None:
            workers = max(1, min(MOST_WORKERS, (len(os.sched_getaffinity(0)) - 1) // self.rank.size))
            self._ahead = Prefetch(self.packed, ahead=2 * workers, workers=workers)
        return self._ahead[step].unpacked(device)

    def packed(self, step: int) -> PackedBatch:
        """What :meth:`load` gives for a step, ready to travel."""
        return self._made(step).packed()

    def close(self) -> None:
        """End the processes that make batches."""
        if self._ahead is not None:
            self._ahead.close()

    def _made(self, step: int) -> Batch:
        numbers, share = self.frame_numbers(step), self.rank.share
        batch = self.frames.batch(share(numbers), share(step_seeds(self.seed, step, numbers)))
        if self.config.cut_frames:
            size = frame_size(batch.depth.shape[1], batch.depth.shape[2], self._drawing(5, step))
            batch = framed(batch, size, [self._drawing(6, step, int(number)) for number in share(numbers)])
        generators = (generator_of(self.seed, step, number) for number in share(range(len(numbers))))
        images = [self._degraded(*image) for image in zip(batch.depth, generators, strict=True)]
        return batch._replace(depth=torch.stack(images))

    def _drawing(self, *key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def _degraded(self, depth: torch.Tensor, generator: np.random.Generator) -> torch.Tensor:
        frames, bounds = self.frames, self.degradation
        return torch.from_numpy(degrade(depth.numpy(), bounds, frames.model.diameter, frames.camera.fx, generator))


def degradation_of(config: TrainConfig, frames: Frames) -> Degradation:
    """How far images are degraded: on shards that carry a sensor's errors already, half as far."""
    bounds = Degradation(config.augment_noise, config.augment_holes)
    return bounds.times(0.5) if frames.sensor is not None else bounds
