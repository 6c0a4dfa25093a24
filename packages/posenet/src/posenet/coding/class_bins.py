"""A number as a class: bins along a line or around a circle, with one-hot or soft labels, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Bins:
    """`count` equal bins over [low, high); a circle closes at high = low + period."""

    count: int
    low: float
    high: float
    circular: bool = False

    @property
    def width(self) -> float:
        return (self.high - self.low) / self.count

    def position(self, value: Tensor) -> Tensor:
        """Values (...) to fractional bin positions (...): the center of bin i is at i."""
        position = (value - self.low) / self.width - 0.5
        return torch.remainder(position + 0.5, self.count) - 0.5 if self.circular else position

    def value(self, position: Tensor) -> Tensor:
        """Fractional bin positions (...) to values (...), within [low, high)."""
        if self.circular:
            position = torch.remainder(position + 0.5, self.count) - 0.5
        return self.low + (position + 0.5) * self.width

    def index(self, value: Tensor) -> Tensor:
        """The bin (...) that holds each value (...); beyond the ends of a line, the last one."""
        return self.position(value).add(0.5).floor().long().clamp(0, self.count - 1)

    def labels(self, value: Tensor, sigma: float) -> Tensor:
        """Target distributions (..., count): one-hot for sigma 0, else a Gaussian of `sigma` bins about the value."""
        if sigma == 0:
            return torch.nn.functional.one_hot(self.index(value), self.count).to(value.dtype)
        position = self.position(value)
        if not self.circular:
            position = position.clamp(0, self.count - 1)
        distance = torch.arange(self.count, device=value.device, dtype=value.dtype) - position[..., None]
        if self.circular:
            distance = torch.remainder(distance + self.count / 2, self.count) - self.count / 2
        weights = torch.exp(-0.5 * (distance / sigma) ** 2)
        return weights / weights.sum(-1, keepdim=True)

    def peaks(self, log_probabilities: Tensor, k: int, interpolate: bool) -> tuple[Tensor, Tensor]:
        """The k best modes: log-probabilities (..., count) to values (..., k) and log-masses (..., k), best first.

        With `interpolate` a mode is a local maximum, its value the mean of it and its two neighbors, its mass theirs
        together; without, a mode is a bin. Where there are fewer modes than k, mass is -inf.
        """
        k = min(k, self.count)
        if not interpolate:
            mass, index = log_probabilities.topk(k, dim=-1)
            return self.value(index.to(mass.dtype)), mass
        left, right = self._neighbors(log_probabilities)
        is_peak = (log_probabilities >= left) & (log_probabilities > right)
        mass3 = torch.logsumexp(torch.stack([left, log_probabilities, right]), 0)
        _, index = log_probabilities.masked_fill(~is_peak, -math.inf).topk(k, dim=-1)
        shift = (right - mass3).exp() - (left - mass3).exp()
        position = index.to(shift.dtype) + shift.gather(-1, index)
        found = is_peak.gather(-1, index)
        return self.value(position), mass3.gather(-1, index).masked_fill(~found, -math.inf)

    def _neighbors(self, values: Tensor) -> tuple[Tensor, Tensor]:
        left, right = values.roll(1, -1), values.roll(-1, -1)
        if not self.circular:
            left, right = left.clone(), right.clone()
            left[..., 0] = -math.inf
            right[..., -1] = -math.inf
        return left, right
