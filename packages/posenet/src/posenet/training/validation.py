"""AP on frames that the network does not train on, by evalkit's own protocol; and how many boxes it finds there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.datasets.scene import Share
from evalkit.scoring.evaluation import average_precision
from posenet.layers.ops import box_iou
from posenet.network.pose_network import PoseNetwork
from posenet.training.dataset import Frames

BATCH = 4
SHARE: Share = "geometric"  # by which evalkit, too, asks for instances of our own data
SEEN, OVERLAP = 0.5, 0.7  # an instance so visible is found by a box of such an IoU, which chance boxes seldom have


class Validation(NamedTuple):
    """What a network does on held-out frames."""

    ap: float  # Sym, Siléane protocol, at least half visible by SHARE
    box_recall: float  # of the instances with half of them returned, the share whose box some hypothesis comes from


@torch.no_grad()
def validate(network: PoseNetwork, frames: Frames, numbers: NDArray[np.int64], device: torch.device) -> Validation:
    """Measure the network on the frames `numbers`."""
    network.eval()
    truth, found, hits = [], [], []
    for start in range(0, len(numbers), BATCH):
        some = numbers[start : start + BATCH]
        batch = frames.batch(some).to(device)
        for row, image in enumerate(network.predict(batch.depth, batch.intrinsics)):
            reader, frame = frames.dataset.locate(int(some[row]))
            labels = reader.labels(frame)
            name, visibility = reader.image_id(frame), labels.visibility(SHARE)
            truth.append(GroundTruthImage(name, frames.stored_camera, labels.cam_from_obj, visibility))
            poses = network.codec.cam_from_obj(image.rotation, image.center)
            found.append(PredictionImage(name, poses, image.score.double().cpu().numpy()))
            hits.append(_boxes_found(batch.boxes[row][batch.visibility[row] >= SEEN], image.box))
    result = average_precision(Predictions(frames.model.name, found), GroundTruth(frames.model, truth, share=SHARE))
    return Validation(result.ap, float(torch.cat(hits).float().mean()) if hits else 0.0)


def _boxes_found(wanted: Tensor, boxes: Tensor) -> Tensor:
    """Which of the boxes (n, 4) one of (m, 4) matches."""
    if len(boxes) == 0:
        return torch.zeros(len(wanted), dtype=torch.bool, device=wanted.device)
    return box_iou(wanted, boxes).amax(1) >= OVERLAP
