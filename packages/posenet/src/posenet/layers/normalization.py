"""What follows a convolution: batch normalization that several processes share, or group normalization."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, distributed, nn

GROUPS = 8


def build_normalization(kind: str, channels: int) -> nn.Module:
    """`batch` normalizes over the images of a step, `group` within each image: for batches of one or two."""
    return SharedBatchNorm2d(channels) if kind == "batch" else nn.GroupNorm(GROUPS, channels)


class SharedBatchNorm2d(nn.BatchNorm2d):
    """Batch normalization over the images of all processes that train together; torch's own in a single one.

    torch.nn.SyncBatchNorm refuses the CPU. All processes must come by as often: they run one network on their images.
    """

    def forward(self, input: Tensor) -> Tensor:
        if not self.training or not together():
            return super().forward(input)
        values = input.float()
        total = all_reduced(torch.cat([values.sum((0, 2, 3)), values.new_tensor([values[:, 0].numel()])]))
        count = total[-1].clamp(min=1.0)
        mean = total[:-1] / count
        centered = values - mean[:, None, None]
        variance = all_reduced(centered.square().sum((0, 2, 3))) / count
        self._remember(mean.detach(), variance.detach() * (count / (count - 1).clamp(min=1.0)).detach())
        scale = self.weight * torch.rsqrt(variance + self.eps)
        return (centered * scale[:, None, None] + self.bias[:, None, None]).to(input.dtype)

    @torch.no_grad()
    def _remember(self, mean: Tensor, variance: Tensor) -> None:
        assert self.running_mean is not None and self.running_var is not None and self.momentum is not None
        assert self.num_batches_tracked is not None
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean, self.momentum)
        self.running_var.lerp_(variance, self.momentum)


def together() -> bool:
    """Whether this process trains with others."""
    return distributed.is_available() and distributed.is_initialized() and distributed.get_world_size() > 1


def all_reduced(values: Tensor) -> Tensor:
    """The sum of all processes' `values`, with a gradient."""
    return _AllReduce.apply(values)


class _AllReduce(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        total = values.clone()
        distributed.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        total = gradient.contiguous().clone()
        distributed.all_reduce(total)
        return total
