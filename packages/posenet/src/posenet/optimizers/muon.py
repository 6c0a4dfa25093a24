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
            moving = [parameter for parameter in group["params"] if parameter.grad is not None]
            updates = self._adam_updates([parameter for parameter in moving if not is_matrix(parameter)])
            for alike in _by_shape(filter(is_matrix, moving)):
                updates += self._matrix_updates(alike)
            if updates:
                parameters, by = zip(*updates, strict=True)
                torch._foreach_mul_(parameters, 1 - group["lr"] * group["weight_decay"])
                torch._foreach_sub_(parameters, by, alpha=group["lr"])
        return loss

    def _matrix_updates(self, parameters: list[Tensor]) -> list[tuple[Tensor, Tensor]]:
        """Of parameters of one shape, together: a step is thousands of small operations otherwise, which a GPU's host
        takes longer to launch than the GPU to do.
        """
        gradients = _gradients(parameters)
        for parameter, gradient in zip(parameters, gradients, strict=True):
            if not self.state[parameter]:
                self.state[parameter]["momentum"] = torch.zeros_like(gradient)
        momenta = [self.state[parameter]["momentum"] for parameter in parameters]
        torch._foreach_lerp_(momenta, gradients, 1 - MOMENTUM)
        ahead = torch.stack([_rows(part) for part in torch._foreach_lerp(gradients, momenta, MOMENTUM)])
        turned = orthogonal(ahead.to(self.precision)).to(ahead.dtype)
        turned = turned.mul_(ADAM_SIZE * math.sqrt(max(ahead.shape[1:])))
        return [(parameter, _shaped(rows, parameter)) for parameter, rows in zip(parameters, turned, strict=True)]

    def _adam_updates(self, parameters: list[Tensor]) -> list[tuple[Tensor, Tensor]]:
        if not parameters:
            return []
        gradients = _gradients(parameters)
        for parameter, gradient in zip(parameters, gradients, strict=True):
            if not self.state[parameter]:
                zero = torch.zeros_like(gradient)
                self.state[parameter] |= {"step": 0, "mean": zero, "square": zero.clone()}
            self.state[parameter]["step"] += 1
        means, squares, steps = ([self.state[p][name] for p in parameters] for name in ("mean", "square", "step"))
        torch._foreach_lerp_(means, gradients, 1 - BETAS[0])
        torch._foreach_lerp_(squares, torch._foreach_mul(gradients, gradients), 1 - BETAS[1])
        sizes = torch._foreach_sqrt(torch._foreach_div(squares, [1 - BETAS[1] ** step for step in steps]))
        torch._foreach_add_(sizes, EPSILON)
        unbiased = torch._foreach_div(means, [1 - BETAS[0] ** step for step in steps])
        return list(zip(parameters, torch._foreach_div(unbiased, sizes), strict=True))


def _gradients(parameters: list[Tensor]) -> list[Tensor]:
    return [parameter.grad for parameter in parameters if parameter.grad is not None]


def _by_shape(parameters: Iterable[Tensor]) -> list[list[Tensor]]:
    alike: dict[torch.Size, list[Tensor]] = {}
    for parameter in parameters:
        alike.setdefault(parameter.shape, []).append(parameter)
    return list(alike.values())


def _rows(weights: Tensor) -> Tensor:
    """Weights (out, in, ...) as a matrix (out, rest), input channels last as convolutions keep them."""
    return weights.movedim(1, -1).reshape(len(weights), -1)


def _shaped(rows: Tensor, like: Tensor) -> Tensor:
    """What :func:`_rows` took apart."""
    return rows.view(len(like), *like.shape[2:], like.shape[1]).movedim(-1, 1)


def is_matrix(parameter: Tensor) -> bool:
    """Whether :class:`Muon` makes its updates orthogonal."""
    return parameter.dim() >= 2 and parameter.numel() <= LARGEST


def orthogonal(matrices: Tensor) -> Tensor:
    """About the nearest matrices (..., m, n) with orthonormal rows or columns, by Newton-Schulz iterations."""
    a, b, c = COEFFICIENTS
    is_wide = matrices.shape[-2] <= matrices.shape[-1]
    wide = (matrices if is_wide else matrices.mT).reshape(-1, *sorted(matrices.shape[-2:]))
    x = wide / (wide.flatten(1).norm(dim=1)[:, None, None] + 1e-7)
    for _ in range(ITERATIONS):
        gram = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    turned = x.reshape(*matrices.shape[:-2], *x.shape[-2:])
    return turned if is_wide else turned.mT
