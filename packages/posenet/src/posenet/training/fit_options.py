"""What a user asks of a training run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posenet.config import Config

CHECKPOINT_SECONDS = 60.0


@dataclass(frozen=True)
class FitOptions:
    """What to train on, how long, and where to put it."""

    shards: list[Path]
    out: Path
    config: Config
    minutes: float | None = None
    epochs: int | None = None
    device: str = "auto"
    devices: int = 1  # GPUs, or processes on the CPU, that share every batch
    scale: float | None = None  # of the images' sides; None: as large as the network likes objects
    seed: int = 0
    validate: bool = True
    backbone_weights: Path | None = None  # ImageNet's VGG16, torchvision's file
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    command: str = ""  # as typed; noted in the run's folder
