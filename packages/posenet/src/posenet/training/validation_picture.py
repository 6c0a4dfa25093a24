"""One validation image with what is true and what is predicted, for the eye: the same image all through a run."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.drawing.overlays import GREEN, WHITE, draw_poses
from posenet.network.pose_network import PoseNetwork
from posenet.training.dataset import Frames

SCALE = 2
LEAST_SCORE, MOST_POSES = 0.3, 40
LEAST_VISIBILITY = 0.5


@torch.no_grad()
def draw_validation(network: PoseNetwork, frames: Frames, number: int, device: torch.device) -> NDArray[np.uint8]:
    """Frame `number` with the outlines of instances at least half visible in white, and of poses in green.

    Returns:
        (2 height, 2 width, 3) RGB.
    """
    network.eval()
    view = frames.dataset[number]
    batch = frames.batch(np.array([number])).to(device)
    found = network.predict(batch.depth, batch.intrinsics)[0]
    shown = (found.score >= LEAST_SCORE).nonzero()[:MOST_POSES, 0]
    predicted = network.codec.cam_from_obj(found.rotation[shown], found.center[shown])
    truth = view.instances.cam_from_obj[view.instances.visibility >= LEAST_VISIBILITY]
    picture = draw_poses(view.depth, frames.stored_camera, frames.model, truth, WHITE, scale=SCALE)
    picture = draw_poses(view.depth, frames.stored_camera, frames.model, predicted, GREEN, scale=SCALE, canvas=picture)
    return np.ascontiguousarray(picture[..., ::-1])
