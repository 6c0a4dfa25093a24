"""What is read off one region: offset, depth and angle classes, and (option) a rotation by regression."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from posenet.coding import euler
from posenet.config import NetworkConfig
from posenet.layers.normalization import build_normalization
from posenet.network.depth_input import CROP_CHANNELS


class PoseOutputs(NamedTuple):
    """Raw outputs for n regions, float32."""

    offset: Tensor  # (n, 2) sides of the region
    depth: Tensor  # (n, depth bins) logits
    angles: tuple[Tensor, Tensor, Tensor]  # logits of a, b, c
    rotation: Tensor  # (n, 3, 3) regressed, ray frame
    features: Tensor  # (n, fc) what the heads saw

    def select(self, rows: Tensor) -> PoseOutputs:
        a, b, c = (angle[rows] for angle in self.angles)
        return PoseOutputs(self.offset[rows], self.depth[rows], (a, b, c), self.rotation[rows], self.features[rows])

    @classmethod
    def joined(cls, parts: list[PoseOutputs]) -> PoseOutputs:
        """The regions of several outputs, one after the other."""
        offset, depth, angles, rotation, features = zip(*parts, strict=True)
        a, b, c = (torch.cat(angle) for angle in zip(*angles, strict=True))
        return cls(torch.cat(offset), torch.cat(depth), (a, b, c), torch.cat(rotation), torch.cat(features))


class PoseHeads(nn.Module):
    """Two fully connected layers over the pooled features, then one linear layer a task (the paper's figure 2).

    With `crop_size` a small convolutional branch adds the raw depth of the region, which keeps the millimeters that a
    trunk at stride 8 has pooled away.
    """

    def __init__(self, channels: int, angle_counts: tuple[int, int, int], config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        size = config.roi_size
        self.crop = CropBranch(config) if config.crop_size else None
        merged = channels + (self.crop.channels if self.crop else 0)
        self.merge = nn.Sequential(*_normalized(merged, channels, config.norm)) if self.crop else nn.Identity()
        width = config.fc_width
        self.trunk = nn.Sequential(
            nn.Flatten(),
            nn.Linear(channels * size * size, width),
            nn.ReLU(),
            nn.Dropout(config.dropout),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Dropout(config.dropout),
        )
        self.offset = nn.Linear(width, 2)
        self.depth = nn.Linear(width, config.depth_bins)
        self.angles = nn.ModuleList(nn.Linear(width, count) for count in angle_counts)
        self.rotation = nn.Linear(width, 6) if config.regress_rotation else None
        self._initialize()

    def forward(self, pooled: Tensor, crops: Tensor | None) -> PoseOutputs:
        """pooled (n, C, S, S) features and crops (n, 4, c, c), None without a crop branch."""
        if self.crop is not None and crops is not None:
            pooled = torch.cat([pooled, self.crop(crops)], 1)
        features = self.trunk(self.merge(pooled))
        a, b, c = (head(features).float() for head in self.angles)
        if self.rotation is not None:
            rotation = euler.from_6d(self.rotation(features).float())
        else:
            rotation = torch.eye(3, device=features.device).expand(features.shape[0], 3, 3)
        offset = self.offset(features).float()
        if not self.config.offset:
            offset = offset * 0.0
        return PoseOutputs(offset, self.depth(features).float(), (a, b, c), rotation, features)

    def _initialize(self) -> None:
        for module in self.trunk:
            if isinstance(module, nn.Linear):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)
        for head in (self.offset, self.depth, *self.angles):
            nn.init.normal_(head.weight, std=0.01)
            nn.init.zeros_(head.bias)
        if self.rotation is not None:
            nn.init.normal_(self.rotation.weight, std=0.01)
            with torch.no_grad():
                self.rotation.bias.copy_(torch.tensor([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]))


class CropBranch(nn.Module):
    """Convolutions that halve a raw crop until it has the pooled features' size, wider at each level."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels, size = CROP_CHANNELS, config.crop_size
        for level, width in enumerate(config.crop_widths):
            if level:
                layers.append(nn.MaxPool2d(2))
                size //= 2
            for _ in range(config.crop_layers):
                layers += _normalized(channels, width, config.norm)
                channels = width
        layers.append(nn.AdaptiveAvgPool2d(config.roi_size) if size != config.roi_size else nn.Identity())
        self.layers = nn.Sequential(*layers)
        self.channels = channels

    def forward(self, crops: Tensor) -> Tensor:
        return self.layers(crops)


def _normalized(channels: int, width: int, norm: str) -> list[nn.Module]:
    return [nn.Conv2d(channels, width, 3, padding=1, bias=False), build_normalization(norm, width), nn.ReLU()]
