"""Labels for images that nobody labeled: refined poses that the image verifies.

What the network found but the image does not verify is neither a part nor background: its box is labeled as an instance
too hidden to train on, which the detector and the scores leave out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from evalkit.datasets.documents import PredictionImage
from evalkit.evidence.verdict import PoseEvidence, Verdict, Verifier
from evalkit.evidence.verification import verify_image
from evalkit.geometry.camera import Camera
from posenet.network.depth_input import resample
from posenet.prediction.any_camera import trained_grid
from posenet.prediction.predictor import Predictor

Array = NDArray[np.float64]
LEAST_SCORE = 0.02  # of poses that are looked at: what the image verifies is a label, whatever its score
UNSURE = 0.1  # the score from which what it does not verify may be a part after all
LEAST_AGREEING = 0.3  # of the silhouette; verified parts seen less are not learned from
FEWEST_PIXELS = 20


@dataclass(frozen=True, eq=False)
class LabeledImage:
    """One image on the network's pixel grid, with n labels.

    Attributes:
        depth: (H, W) meters, 0 = no return.
        cam_from_obj: (n, 4, 4). boxes: (n, 4) visible boxes, pixels. visibility: (n,), 0 of what is not to be learned.
    """

    depth: Tensor
    camera: Camera
    cam_from_obj: Tensor
    boxes: Tensor
    visibility: Tensor

    @property
    def count(self) -> int:
        """How many instances are learned."""
        return int((self.visibility > 0).sum())

    @property
    def learned(self) -> Tensor:
        """The poses (m, 4, 4) that are learned."""
        return self.cam_from_obj[self.visibility > 0]

    def upside_down(self) -> LabeledImage:
        """The same scene as the camera sees it turned by 180 degrees about its axis."""
        width, height = self.camera.width, self.camera.height
        turn = torch.diag(torch.tensor([-1.0, -1.0, 1.0, 1.0])).to(self.cam_from_obj)
        camera = Camera(
            width, height, self.camera.fx, self.camera.fy, width - 1 - self.camera.cx, height - 1 - self.camera.cy
        )
        size = self.boxes.new_tensor([width, height, width, height])
        boxes = (size - self.boxes)[:, [2, 3, 0, 1]]
        return LabeledImage(self.depth.flip(0, 1), camera, turn @ self.cam_from_obj, boxes, self.visibility)


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
    verified = verify_image(image, depth, camera, verifier, LEAST_SCORE)
    grid = trained_grid(depth, camera, predictor.network)
    scale = np.tile([grid.width / camera.width, grid.height / camera.height], 2)
    cam_from_obj, boxes, visibility = [], [], []
    rows = zip(verified.row, verified.score, verified.evidence, verified.duplicate_of, strict=True)
    for row, score, part, other in rows:
        sure = _is_sure(part)
        if other is not None or (not sure and (row < len(known) or score < UNSURE)):
            continue
        cam_from_obj.append(part.cam_from_obj)
        boxes.append((_seen_box(part, camera) if sure else found.boxes[row - len(known)]) * scale)
        visibility.append(max(part.agreeing, LEAST_AGREEING) if sure else 0.0)
    return LabeledImage(
        resample(torch.from_numpy(depth), grid),
        grid,
        torch.from_numpy(np.reshape(cam_from_obj, (-1, 4, 4))).float(),
        torch.from_numpy(np.reshape(boxes, (-1, 4))).float(),
        torch.tensor(visibility),
    )


def _is_sure(part: PoseEvidence) -> bool:
    return part.verdict is Verdict.VERIFIED and part.agreeing >= LEAST_AGREEING and len(part.pixels) >= FEWEST_PIXELS


def _seen_box(part: PoseEvidence, camera: Camera) -> Array:
    """x0, y0, x1, y1 around the pixels where the image shows the part, as labels of shards have it."""
    v, u = np.divmod(part.pixels, camera.width)
    return np.array([u.min(), v.min(), u.max() + part.stride, v.max() + part.stride], float)
