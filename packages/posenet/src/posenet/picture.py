"""Predictions drawn on their depth image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from evalkit.overlays import draw_poses
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.camera import Camera
from evalkit.objects import ObjectModel
from posenet.predict import PredictedPoses

GREEN = (80, 220, 80)


def draw_predictions(
    depth: NDArray[np.float32], camera: Camera, model: ObjectModel, found: PredictedPoses, least_score: float
) -> NDArray[np.uint8]:
    """The depth image in false colours with contours, boxes and scores of poses at or above `least_score` (H, W, 3)."""
    shown = found.score >= least_score
    poses = found.cam_from_obj[shown]
    picture = draw_poses(depth, camera, model, poses, [GREEN] * len(poses))
    centers = camera.project(model.centers(poses)) if len(poses) else np.zeros((0, 2))
    scale = picture.shape[1] / camera.width
    for box, score, center in zip(found.boxes[shown], found.score[shown], centers, strict=True):
        x0, y0, x1, y1 = (round(float(edge) * scale) for edge in box)
        cv2.rectangle(picture, (x0, y0), (x1, y1), (200, 200, 200), 1)
        u, v = (round(float(value + 0.5) * scale) for value in center)
        cv2.drawMarker(picture, (u, v), (255, 255, 255), cv2.MARKER_CROSS, 6, 1)
        cv2.putText(picture, f"{score:.2f}", (x0 + 1, y0 + 9), cv2.FONT_HERSHEY_SIMPLEX, 0.3, (255, 255, 255), 1)
    return picture


def write_picture(path: Path | str, picture: NDArray[np.uint8]) -> None:
    """Write a BGR picture (H, W, 3) as PNG, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
