"""Training batches of labeled images: shuffled, turned and zoomed, degraded as other cameras might."""

from __future__ import annotations

import math

import numpy as np
import torch

from posenet.adaptation.labeled_image import LabeledImage
from posenet.augmentation.depth_errors import Degradation, degrade
from posenet.config import TrainConfig
from posenet.network.depth_input import intrinsics_of
from posenet.network.targets import Batch
from posenet.training.dataset import step_seeds

ZOOM = 1.15  # at most, in and out
DEGRADED = 0.5  # times as far as ideal depth is, for these images carry their camera's errors already


def batch_of(images: list[LabeledImage], config: TrainConfig, diameter: float, seed: int, step: int) -> Batch:
    """The batch of a step: as many images as training took, of one size; it follows from seed and step."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5, step)))
    first = images[int(rng.integers(len(images)))]
    alike = [image for image in images if image.depth.shape == first.depth.shape]
    chosen = rng.choice(len(alike), min(config.batch_images, len(alike)), replace=False)
    some = [alike[number].turned(rng.uniform(-math.pi, math.pi), _zoom(rng)) for number in chosen]
    return Batch(
        depth=torch.stack([_degraded(image, diameter, rng) for image in some]),
        intrinsics=torch.stack([intrinsics_of(image.camera) for image in some]),
        poses=[image.cam_from_obj for image in some],
        boxes=[image.boxes for image in some],
        visibility=[image.visibility for image in some],
        seeds=step_seeds(seed, step, chosen),
    )


def _zoom(rng: np.random.Generator) -> float:
    return ZOOM ** float(rng.uniform(-1.0, 1.0))


def _degraded(image: LabeledImage, diameter: float, rng: np.random.Generator) -> torch.Tensor:
    usual = TrainConfig()
    bounds = Degradation(usual.augment_noise, usual.augment_holes).times(DEGRADED)
    depth = np.ascontiguousarray(image.depth.numpy())
    return torch.from_numpy(degrade(depth, bounds, diameter, image.camera.fx, rng))
