"""Muon: momentum whose update of each matrix is made orthogonal (Jordan et al. 2024), AdamW for all that is no matrix.

A gradient of a layer has few large singular values and many small ones; a step along all of them alike learns more from
an image. The update is scaled to AdamW's usual size (Liu et al. 2025, "Muon is scalable for LLM training", eq. 4), so
that one learning rate and weight decay serve both kinds of parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

MOMENTUM = 0.95
BETAS = (0.9, 0.95)
EPSILON = 1e-8
COEFFICIENTS = (3.4445, -4.7750, 2.0315)  # of the quintic iteration; Jordan's, which aim at singular values near one
ITERATIONS = 5
LARGEST = 2**21  # entries; orthogonalizing a larger matrix would take a CPU longer than the step itself
ADAM_SIZE = 0.2  # root mean square of AdamW's updates


class Muon(torch.optim.Optimizer):
    """Of parameters in any order: those of two or more dimensions, as (out, rest) matrices, take Muon's steps.

    `precision` is that of the iterations: bfloat16 is exact enough, and three times as fast where the hardware has it.
    """

    def __init__(
        self, parameters: Iterable[Any], lr: float, weight_decay: float = 0.0, precision: torch.dtype = torch.float32
    ) -> None:
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})
        self.precision = precision

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """One step along the gradients."""
        loss = closure() if closure is not None else None
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                update = self._matrix_update(parameter) if is_matrix(parameter) else self._adam_update(parameter)
                parameter.mul_(1 - group["lr"] * group["weight_decay"]).sub_(update, alpha=group["lr"])
        return loss

    def _matrix_update(self, parameter: Tensor) -> Tensor:
        gradient, state = parameter.grad, self.state[parameter]
        assert gradient is not None
        if not state:
            state["momentum"] = torch.zeros_like(gradient)
        momentum = state["momentum"].lerp_(gradient, 1 - MOMENTUM)
        ahead = gradient.lerp(momentum, MOMENTUM).reshape(len(parameter), -1)
        turned = orthogonal(ahead.to(self.precision)).to(parameter.dtype)
        return turned.mul_(ADAM_SIZE * math.sqrt(max(ahead.shape))).reshape(parameter.shape)

    def _adam_update(self, parameter: Tensor) -> Tensor:
        gradient, state = parameter.grad, self.state[parameter]
        assert gradient is not None
        if not state:
            state |= {"step": 0, "mean": torch.zeros_like(gradient), "square": torch.zeros_like(gradient)}
        state["step"] += 1
        mean = state["mean"].lerp_(gradient, 1 - BETAS[0]) / (1 - BETAS[0] ** state["step"])
        square = state["square"].lerp_(gradient.square(), 1 - BETAS[1]) / (1 - BETAS[1] ** state["step"])
        return mean / (square.sqrt_() + EPSILON)


def is_matrix(parameter: Tensor) -> bool:
    """Whether :class:`Muon` makes its updates orthogonal."""
    return parameter.dim() >= 2 and parameter.numel() <= LARGEST


def orthogonal(matrix: Tensor) -> Tensor:
    """About the nearest matrix (m, n) with orthonormal rows or columns, by Newton-Schulz iterations."""
    a, b, c = COEFFICIENTS
    wide = matrix if matrix.shape[0] <= matrix.shape[1] else matrix.T
    x = wide / (wide.norm() + 1e-7)
    for _ in range(ITERATIONS):
        gram = x @ x.T
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x if wide is matrix else x.T
