"""Multi-task network for the 6D poses of objects in crowds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posenet.threads import wait_briefly

if TYPE_CHECKING:
    from posenet.prediction.predictor import Predictor

wait_briefly()  # before anything loads PyTorch, which reads it once


def load(model: Path | str, device: str = "auto", refine: bool = False) -> Predictor:
    """A trained model, ready to predict::

        poses = posenet.load("model.pt").predict(depth, Camera.load("camera.json"))
        poses.cam_from_obj  # (n, 4, 4) meters, best first: the object's mesh frame to OpenCV's camera axes
        poses.score         # (n,) 0 to 1, descending
        poses.boxes         # (n, 4) x0, y0, x1, y1 in pixels, of the detection each comes from
        poses.detection     # (n,) number of that detection

    `depth` is (height, width): axial z in meters, 0 or NaN where nothing returned. `model` is a model file or a run's
    folder; with `refine` poses are fitted to the depth image and verified.

    Raises:
        InputError: there is no usable model, or no such device.
    """
    from posenet.prediction.predictor import Predictor

    return Predictor.load(model, device, refine)
