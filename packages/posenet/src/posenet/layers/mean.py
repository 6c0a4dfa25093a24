"""A mean that several processes can take together: each has the sum and the count of its own share."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Mean(NamedTuple):
    """A loss as a sum and how many it is a sum over; the sums and counts of all processes make the loss of all."""

    total: Tensor  # scalar
    over: Tensor  # scalar, no gradient

    @classmethod
    def of(cls, values: Tensor, count: int | Tensor | None = None) -> Mean:
        """The sum of `values` over `count`, their number if not said."""
        number = values.numel() if count is None else count
        return cls(values.sum(), torch.as_tensor(number, dtype=values.dtype, device=values.device))

    @property
    def value(self) -> Tensor:
        """The mean; 0 of nothing."""
        return self.total / self.over.clamp(min=1.0)
