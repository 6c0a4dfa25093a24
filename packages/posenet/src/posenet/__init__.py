"""Multi-task network for the 6D poses of objects in crowds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posenet.predict import Predictor


def load(model: Path | str, device: str = "auto", refine: bool = False) -> Predictor:
    """A trained model, ready to predict: ``posenet.load("model.pt").predict(depth, camera)``.

    `model` is a model file or a run's folder; with `refine` poses are fitted to the depth image and verified.

    Raises:
        InputError: there is no usable model, or no such device.
    """
    from posenet.predict import Predictor

    return Predictor.load(model, device, refine)
