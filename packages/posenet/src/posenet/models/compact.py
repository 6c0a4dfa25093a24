"""A model's weights in a quarter of the bytes, for models that travel: int8 rows with a scale each, the rest float16.

Rounding moves a weight by at most 1/254 of the largest in its row, which is far below what one step of training does;
whether a model can bear it is measured, not assumed: score the compact file before you ship it.
"""

from __future__ import annotations

import torch
from torch import Tensor

STEPS = 127
LEAST_VALUES = 4096  # smaller tensors are kept in float16: they weigh nothing and may matter
SCALE = ".scale"  # suffix of the row scales' names


def compact(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Float weights by name to fewer bytes; whole numbers (counters) stay."""
    packed: dict[str, Tensor] = {}
    for name, value in weights.items():
        if not value.is_floating_point():
            packed[name] = value
        elif value.ndim < 2 or value.numel() < LEAST_VALUES:
            packed[name] = value.half() if value.abs().max() < torch.finfo(torch.half).max else value
        else:
            rows = value.flatten(1)
            scale = (rows.abs().amax(1) / STEPS).clamp(min=1e-12)
            packed[name] = (rows / scale[:, None]).round().to(torch.int8).view(value.shape).contiguous()
            packed[name + SCALE] = scale
    return packed


def expand(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """What :func:`compact` packed, as float32 again; weights that were not packed pass through."""
    full: dict[str, Tensor] = {}
    for name, value in weights.items():
        if name.endswith(SCALE) and name.removesuffix(SCALE) in weights:
            continue
        if value.dtype == torch.int8 and name + SCALE in weights:
            scale = weights[name + SCALE].float()
            full[name] = value.float() * scale.view(-1, *([1] * (value.ndim - 1)))
        else:
            full[name] = value.float() if value.is_floating_point() else value
    return full
