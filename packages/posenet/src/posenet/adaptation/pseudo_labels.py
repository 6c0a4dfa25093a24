"""Labels for images that nobody labeled: refined poses that score well and that the image verifies.

The image alone is no judge of poses that the scores doubt: a heap of parts has surface in many places, and of poses
scored below 0.5 that it verified nearly all were wrong (benchmarks/RESULTS.md).

What the network found but is no label is not background either: its box is labeled as an instance too hidden to train
on, which the detector and the scores leave out.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage
from evalkit.evidence.verdict import PoseEvidence, Verdict, Verifier
from evalkit.evidence.verification import verify_image
from evalkit.geometry.camera import Camera
from posenet.adaptation.labeled_image import LabeledImage
from posenet.network.depth_input import resample
from posenet.prediction.any_camera import trained_grid
from posenet.prediction.predictor import Predictor

Array = NDArray[np.float64]
UNSURE = 0.1  # the score from which a pose may be a part's, though it is no label
SURE = 0.5  # the score from which a pose that the image verifies is a label
LEAST_AGREEING = 0.3  # of the silhouette; verified parts seen less are not learned from
FEWEST_PIXELS = 20


def label(
    predictor: Predictor,
    verifier: Verifier,
    depth: NDArray[np.float32],
    camera: Camera,
    name: str,
    before: LabeledImage | None = None,
) -> LabeledImage:
    """Labels from what `predictor`, which refines, finds in an image (height, width) in meters of `camera`.

    What an earlier round had verified (`before`) stays a label: a network that learns may find less for a while.
    """
    found = predictor.predict_batch([depth], camera, [name])[0]
    known = np.zeros((0, 4, 4)) if before is None else before.learned.double().numpy()
    poses = np.concatenate([known, found.cam_from_obj])
    image = PredictionImage(name, poses, np.concatenate([np.ones(len(known)), found.score]))
    verified = verify_image(image, depth, camera, verifier, UNSURE)
    grid = trained_grid(depth, camera, predictor.network)
    scale = np.array([grid.width / camera.width, grid.height / camera.height])
    cam_from_obj, outlines, visibility = [], [], []
    rows = zip(verified.row, verified.score, verified.evidence, verified.duplicate_of, strict=True)
    for row, score, part, other in rows:
        sure = score >= SURE and _is_verified(part)
        if other is not None or (not sure and row < len(known)):
            continue
        cam_from_obj.append(part.cam_from_obj)
        outline = _seen_outline(part, camera) if sure else _corners(found.boxes[row - len(known)])
        outlines.append(torch.from_numpy(outline * scale))
        visibility.append(max(part.agreeing, LEAST_AGREEING) if sure else 0.0)
    return LabeledImage(
        resample(torch.from_numpy(depth), grid),
        grid,
        torch.from_numpy(np.reshape(cam_from_obj, (-1, 4, 4))).float(),
        outlines,
        torch.tensor(visibility),
    )


def _is_verified(part: PoseEvidence) -> bool:
    return part.verdict is Verdict.VERIFIED and part.agreeing >= LEAST_AGREEING and len(part.pixels) >= FEWEST_PIXELS


def _seen_outline(part: PoseEvidence, camera: Camera) -> Array:
    """Points (k, 2) around the pixels where the image shows the part, x and y from the image's corner."""
    v, u = np.divmod(part.pixels, camera.width)
    corners = [np.stack([u + right, v + down], -1) for right in (0, part.stride) for down in (0, part.stride)]
    return cv2.convexHull(np.concatenate(corners).astype(np.float32))[:, 0].astype(float)


def _corners(box: Array) -> Array:
    """The corners (4, 2) of a box x0, y0, x1, y1."""
    return box[[[0, 1], [2, 1], [2, 3], [0, 3]]]
