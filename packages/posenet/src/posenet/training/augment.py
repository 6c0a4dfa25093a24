"""What a depth camera might do to an image, drawn anew each time the image trains.

Not a model of one camera (that is simgen's `--sensor`, and belongs into the shards) but of what cameras differ in:
how strong the noise is and how far it reaches across pixels, which side of an edge has no return, how large the holes
are. A network that saw all of it reads the images of a camera that nobody modelled; poses stay as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

OCTAVES = 3  # noise at every pixel, every second, every fourth
EDGE_STEP = 0.15  # diameters between neighbouring pixels that make an edge
EDGE_REACH = 4  # pixels beside an edge that may have no return
EDGE_LOSS = 0.8  # share of them that has none, at most
HOLE_CELL = 6  # pixels across a hole, about


class Degradation(NamedTuple):
    """Upper bounds; each image draws its own values below them."""

    noise: float  # standard deviation of depth, in diameters
    holes: float  # share of pixels without return on smooth surface


def generator_of(seed: int, step: int, image: int) -> torch.Generator:
    """The randomness of one image of one training step: a resumed run degrades as an unbroken one does."""
    state = np.random.SeedSequence(seed, spawn_key=(3, step, image)).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(state >> np.uint64(1)))


def degrade(depth: Tensor, bounds: Degradation, diameter: float, generator: torch.Generator) -> Tensor:
    """One image (H, W) in metres, 0 = no return, as some other camera might have measured it.

    The generator is the CPU's, so that a seed gives the same images on every device.
    """
    draw = _Draw(generator, depth.shape[-2], depth.shape[-1], depth.device)
    sigma = draw.number() * bounds.noise * diameter
    noisy = depth + sigma * draw.correlated_noise() * _slant_factor(depth)
    lost = _highest(draw.field(HOLE_CELL), draw.number() * bounds.holes) | _beside_edges(depth, diameter, draw)
    return torch.where((depth > 0) & ~lost, noisy.clamp(min=1e-3), torch.zeros_like(depth))


class _Draw:
    """Random numbers and fields of one image."""

    def __init__(self, generator: torch.Generator, height: int, width: int, device: torch.device) -> None:
        self.generator, self.height, self.width, self.device = generator, height, width, device

    def number(self) -> float:
        return float(torch.rand((), generator=self.generator))

    def field(self, cell: float) -> Tensor:
        """Smooth noise (H, W) of about unit variance whose correlation reaches `cell` pixels."""
        size = max(2, round(self.height / cell)), max(2, round(self.width / cell))
        coarse = torch.randn(1, 1, *size, generator=self.generator).to(self.device)
        if cell <= 1:
            return coarse[0, 0]
        return F.interpolate(coarse, (self.height, self.width), mode="bilinear", align_corners=False)[0, 0]

    def correlated_noise(self) -> Tensor:
        """Octaves in proportions drawn for this image, together of unit variance."""
        parts = [self.number() * self.field(2.0**octave) for octave in range(OCTAVES)]
        total = torch.stack(parts).sum(0)
        return total / total.std().clamp(min=1e-6)


def _slant_factor(depth: Tensor) -> Tensor:
    """How much noise grows with slope: half as much again at 60 degrees and beyond, as stereo cameras measure."""
    steps = _steps(depth)
    typical = steps.flatten()[::37].median().clamp(min=1e-6)
    return 1.0 + 0.5 * (steps / (4 * typical)).clamp(max=1.0)


def _beside_edges(depth: Tensor, diameter: float, draw: _Draw) -> Tensor:
    """Pixels (H, W) that lose their return beside an edge, on the one side more than on the other."""
    edge = _steps(depth) > EDGE_STEP * diameter
    field, loss = draw.field(HOLE_CELL), EDGE_LOSS * draw.number()
    lost = torch.zeros_like(edge)
    for direction in (-1, 1):
        lost |= _widened(edge, direction * EDGE_REACH) & _highest(field, loss * draw.number())
    return lost


def _widened(mask: Tensor, pixels: int) -> Tensor:
    """The mask (H, W) and so many pixels to the right of it (negative: to the left)."""
    wide = mask.clone()
    for shift in range(1, abs(pixels) + 1):
        if pixels > 0:
            wide[:, shift:] |= mask[:, :-shift]
        else:
            wide[:, :-shift] |= mask[:, shift:]
    return wide


def _highest(field: Tensor, share: float) -> Tensor:
    """About that share of the pixels (H, W), where the field is highest."""
    if share <= 0:
        return torch.zeros_like(field, dtype=torch.bool)
    return field > field.flatten()[::11].quantile(1.0 - share)


def _steps(depth: Tensor) -> Tensor:
    """Absolute difference (H, W) of each pixel's depth to that of its left neighbour; 0 beside holes."""
    known = (depth[:, 1:] > 0) & (depth[:, :-1] > 0)
    return F.pad(torch.diff(depth, dim=1).abs() * known, (1, 0))
