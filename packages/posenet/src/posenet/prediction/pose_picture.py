"""Predictions drawn on their depth image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.drawing.overlays import GRAY, GREEN, WHITE, Color, Image, draw_poses, shade
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.prediction.predictor import PredictedPoses

SHORTEST_SIDE = 600  # pixels; smaller depth images are enlarged
MOST_ENLARGED = 4
AMBER, BLACK = (40, 170, 250), (0, 0, 0)  # BGR


def draw_predictions(
    depth: NDArray[np.float32], camera: Camera, model: ObjectModel, found: PredictedPoses, least_score: float
) -> Image:
    """Poses scored at least `least_score` over the shaded depth image, as (scale H, scale W, 3), BGR.

    Contours from amber (the least score) to green (1), boxes of the detections gray, centers as crosses with the score
    beside them; higher scores are drawn over lower ones, and small images are enlarged by a whole number.
    """
    scale = enlargement(camera)
    picture = shade(depth, camera, scale)
    shown = np.flatnonzero(found.score >= least_score)
    for row in shown:
        _draw_box(picture, found.boxes[row] * scale)
    ascending = shown[np.argsort(found.score[shown], kind="stable")]
    colors = [_color(found.score[row], least_score) for row in ascending]
    poses = found.cam_from_obj[ascending]
    picture = draw_poses(depth, camera, model, poses, colors, scale, 1 if scale == 1 else 2, picture)
    centers = (camera.project(model.centers(poses)) + 0.5) * scale
    for center, row in zip(centers, ascending, strict=True):
        _draw_score(picture, center, found.score[row])
    return picture


def enlargement(camera: Camera) -> int:
    """By how much a camera's images are enlarged, so that a score can be read on them."""
    return min(MOST_ENLARGED, max(1, round(SHORTEST_SIDE / min(camera.width, camera.height))))


def write_picture(path: Path | str, picture: Image) -> None:
    """Write a BGR picture (H, W, 3) as PNG, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", picture)[1].tobytes())


def _color(score: float, least_score: float) -> Color:
    share = np.clip((score - least_score) / max(1.0 - least_score, 1e-6), 0.0, 1.0)
    b, g, r = (round(float(low + share * (high - low))) for low, high in zip(AMBER, GREEN, strict=True))
    return b, g, r


def _draw_box(picture: Image, box: NDArray[np.float64]) -> None:
    x0, y0, x1, y1 = (round(float(edge)) for edge in box)
    cv2.rectangle(picture, (x0, y0), (x1, y1), GRAY, 1)


def _draw_score(picture: Image, center: NDArray[np.float64], score: float) -> None:
    if not (np.abs(center) < 2 * max(picture.shape)).all():
        return  # behind the camera, or so far outside that pixels are no integers of OpenCV's
    u, v = (round(float(value)) for value in center)
    corner = (u + 5, v + 4)
    for color, thickness in ((BLACK, 3), (WHITE, 1)):  # an outline keeps the figures legible on any ground
        cv2.drawMarker(picture, (u, v), color, cv2.MARKER_CROSS, 9, thickness)
        cv2.putText(picture, f"{score:.2f}", corner, cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, thickness, cv2.LINE_AA)
