"""AP on frames that the network does not train on, by evalkit's own protocol."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.scoring.evaluation import Result, average_precision
from posenet.network.pose_network import PoseNetwork
from posenet.training.dataset import Frames

BATCH = 4


@torch.no_grad()
def validate(network: PoseNetwork, frames: Frames, numbers: NDArray[np.int64], device: torch.device) -> Result:
    """Sym AP (Siléane protocol, at least half visible) of the network on the frames `numbers`."""
    network.eval()
    truth, found = [], []
    for start in range(0, len(numbers), BATCH):
        some = numbers[start : start + BATCH]
        batch = frames.batch(some).to(device)
        for number, image in zip(some, network.predict(batch.depth, batch.intrinsics), strict=True):
            reader, row = frames.dataset.locate(int(number))
            labels = reader.labels(row)
            name = reader.image_id(row)
            truth.append(
                GroundTruthImage(name, frames.stored_camera, labels.cam_from_obj, labels.visibility.astype(float))
            )
            poses = network.codec.cam_from_obj(image.rotation, image.center)
            found.append(PredictionImage(name, poses, image.score.double().cpu().numpy()))
    return average_precision(Predictions(frames.model.name, found), GroundTruth(frames.model, truth))
