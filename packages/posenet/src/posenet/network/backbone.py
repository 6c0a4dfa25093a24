"""The trunk: VGG16 as the paper has it, or a thin relative of it for two CPU cores."""

from __future__ import annotations

import pickle
from pathlib import Path

import torch
from torch import Tensor, nn

from evalkit.errors import InputError
from posenet.layers.normalization import build_normalization

VGG16_WIDTHS = (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512)  # 0: halve by max-pooling


class Backbone(nn.Module):
    """Images (B, in_channels, H, W) to features (B, channels, H // stride, W // stride).

    Feature cell (i, j) stands for the pixels [j, j + 1) * stride by [i, i + 1) * stride.
    """

    def __init__(self, features: nn.Sequential, stride: int, channels: int) -> None:
        super().__init__()
        self.features = features
        self.stride = stride
        self.channels = channels
        _initialize(self)

    def forward(self, images: Tensor) -> Tensor:
        return self.features(images)


def build_backbone(name: str, in_channels: int, norm: str = "batch") -> Backbone:
    """The trunk of that name: vgg16 (stride 16, which has no normalization), vgg_small or vgg_debug (stride 8).

    Raises:
        InputError: there is no trunk of that name.
    """
    if name == "vgg16":
        return vgg16(in_channels)
    if name == "vgg_small":
        return thin_vgg(in_channels, norm=norm)
    if name == "vgg_debug":
        return thin_vgg(in_channels, widths=(16, 32, 64), norm=norm)
    raise InputError(f"backbone '{name}' is not known; use vgg16, vgg_small or vgg_debug.")


def vgg16(in_channels: int) -> Backbone:
    """VGG16 up to conv5_3, without the last pooling (Simonyan & Zisserman 2015; Faster R-CNN's use of it).

    The layers are numbered as torchvision's, so its key names (`features.0.weight` …) fit.
    """
    layers: list[nn.Module] = []
    channels = in_channels
    for width in VGG16_WIDTHS:
        if width:
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(inplace=True)]
            channels = width
        else:
            layers.append(nn.MaxPool2d(2))
    return Backbone(nn.Sequential(*layers), stride=16, channels=channels)


def thin_vgg(
    in_channels: int,
    widths: tuple[int, int, int] = (32, 64, 128),
    blocks: tuple[int, int, int] = (1, 2, 3),
    dilated: int = 2,
    norm: str = "batch",
) -> Backbone:
    """VGG's pattern with a stride-2 stem, normalization and dilated last layers; stride 8.

    `blocks` are the layers at strides 2, 4 and 8 beside the stem; `dilated` more follow at stride 8, which widen the
    receptive field from 78 to 142 pixels: more than an object's size, so that one cell sees the whole of it.
    `norm` is 'batch' or, for tiny batches, 'group'.
    """
    # An even kernel centers each output on the 2 x 2 pixels that it stands for; an odd one would shift the grid.
    layers = _convolution(in_channels, widths[0], norm, kernel=4, stride=2)
    channels = widths[0]
    for level, (count, width) in enumerate(zip(blocks, widths, strict=True)):
        layers += [nn.MaxPool2d(2)] if level else []
        for _ in range(count):
            layers += _convolution(channels, width, norm)
            channels = width
    for _ in range(dilated):
        layers += _convolution(channels, channels, norm, dilation=2)
    return Backbone(nn.Sequential(*layers), stride=8, channels=channels)


def load_vgg16_weights(backbone: Backbone, path: Path | str) -> None:
    """Load ImageNet's VGG16 from a local file of torchvision's format; its classifier is left aside.

    Raises:
        InputError: the file is absent, is not a file of weights, or does not fit this trunk.
    """
    weights = _read_state_dict(Path(path))
    wanted = backbone.state_dict()
    for name, tensor in wanted.items():
        found = weights.get(name)
        if found is None or found.shape != tensor.shape:
            has = "lacks it" if found is None else f"has {tuple(found.shape)}"
            raise InputError(
                f"{path}: does not fit this trunk: '{name}' must have the shape {tuple(tensor.shape)}, the file {has}; "
                "give torchvision's vgg16 weights and a three-channel vgg16 trunk."
            )
    backbone.load_state_dict({name: weights[name] for name in wanted})


def _read_state_dict(path: Path) -> dict[str, Tensor]:
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give a local copy of torchvision's vgg16 weights (.pth).") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the file of torchvision's vgg16 weights (.pth).") from None
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError, AttributeError):
        document = None
    if not isinstance(document, dict) or not all(isinstance(value, Tensor) for value in document.values()):
        raise InputError(f"{path}: not a file of weights; give torchvision's vgg16 state dict (.pth).")
    return document


def _convolution(
    in_channels: int, width: int, norm: str, kernel: int = 3, stride: int = 1, dilation: int = 1
) -> list[nn.Module]:
    convolution = nn.Conv2d(in_channels, width, kernel, stride, padding=dilation, dilation=dilation, bias=False)
    return [convolution, build_normalization(norm, width), nn.ReLU(inplace=True)]


def _initialize(backbone: Backbone) -> None:
    for module in backbone.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if module.bias is not None:
                nn.init.zeros_(module.bias)
