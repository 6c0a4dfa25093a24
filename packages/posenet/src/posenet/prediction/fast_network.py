"""A network as prediction runs it: the same poses from fewer and cheaper layers.

Batch normalization after a convolution is part of it, pooling comes before the rectifier (of a quarter of the numbers,
and no maximum changes), and weights have the type and the layout that the layers compute in. The network as trained
is the plain reference: it predicts the same, and the tests compare the two.
"""

from __future__ import annotations

import copy
import itertools

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from posenet.network.pose_network import PoseNetwork


def fast_network(network: PoseNetwork, bf16: bool) -> PoseNetwork:
    """A twin of `network`, in eval mode, that predicts the same in less time; its layers compute in bf16 or not.

    `network` stays as it is. Weights that are the same in both are shared, so make another twin after training goes on.
    """
    shared = {id(tensor): tensor for tensor in itertools.chain(network.parameters(), network.buffers())}
    twin = copy.deepcopy(network, {**shared, id(network.model): network.model}).eval()
    twin.bf16 = bf16
    _fold(twin)
    for part in (twin.backbone, twin.detector, twin.heads):  # those whose layers run in bf16
        for layer in part.modules():
            if isinstance(layer, nn.Conv2d | nn.Linear):
                _prepare(layer, torch.bfloat16 if bf16 else torch.float32)
    return twin


def _fold(module: nn.Module) -> None:
    for name, child in module.named_children():
        _fold(child)
        if isinstance(child, nn.Sequential):
            setattr(module, name, nn.Sequential(*_fewer(list(child))))


def _fewer(layers: list[nn.Module]) -> list[nn.Module]:
    """What computes the same as `layers`, one after the other."""
    fewer: list[nn.Module] = []
    for layer in layers:
        before = fewer[-1] if fewer else None
        if isinstance(layer, nn.BatchNorm2d) and isinstance(before, nn.Conv2d):
            fewer[-1] = fuse_conv_bn_eval(before, layer)
        elif isinstance(layer, nn.MaxPool2d) and _halves(layer):
            fewer.insert(len(fewer) - isinstance(before, nn.ReLU), HalvingMax())
        elif isinstance(layer, nn.ReLU):
            fewer.append(nn.ReLU(inplace=before is not None))  # what a layer of this sequence made is nobody else's
        elif not isinstance(layer, nn.Identity | nn.Dropout):
            fewer.append(layer)
    return fewer


class HalvingMax(nn.Module):
    """`nn.MaxPool2d(2)`, without remembering where each maximum was: in less than half the time."""

    def forward(self, values: Tensor) -> Tensor:
        height, width = (size // 2 * 2 for size in values.shape[-2:])
        rows = torch.maximum(values[..., 0:height:2, :width], values[..., 1:height:2, :width])
        return torch.maximum(rows[..., 0::2], rows[..., 1::2])


def _halves(pool: nn.MaxPool2d) -> bool:
    return (pool.kernel_size, pool.stride, pool.padding, pool.dilation, pool.ceil_mode) == (2, 2, 0, 1, False)


def _prepare(layer: nn.Conv2d | nn.Linear, dtype: torch.dtype) -> None:
    """Weights of a type, convolutions' with channels last; new ones, because the old may be shared."""
    for name, value in list(layer.named_parameters(recurse=False)):
        layout = torch.channels_last if value.dim() == 4 else torch.contiguous_format
        fitting = value.detach().to(dtype, memory_format=layout)
        if fitting is not value:
            setattr(layer, name, nn.Parameter(fitting, requires_grad=False))
