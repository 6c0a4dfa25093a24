"""One validation image with what is true and what is predicted, for the eye: the same image all through a run."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.drawing.overlays import GREEN, WHITE, draw_poses
from posenet.network.pose_network import PoseNetwork
from posenet.training.dataset import Frames

LARGEST, MOST_WIDTH = 2, 1280  # the picture is so many times as large as the image, while it is no wider
LEAST_SCORE, MOST_POSES = 0.3, 40
LEAST_VISIBILITY = 0.5


@torch.no_grad()
def draw_validation(network: PoseNetwork, frames: Frames, number: int, device: torch.device) -> NDArray[np.uint8]:
    """Frame `number` with the outlines of instances at least half visible (geometric) in white, and of poses in green.

    Returns:
        (scale height, scale width, 3) RGB.
    """
    network.eval()
    view = frames.dataset[number]
    batch = frames.batch(np.array([number])).to(device)
    found = network.predict(batch.depth, batch.intrinsics)[0]
    shown = (found.score >= LEAST_SCORE).nonzero()[:MOST_POSES, 0]
    scale = max(1, min(LARGEST, MOST_WIDTH // view.camera.width))
    predicted = network.codec.cam_from_obj(found.rotation[shown], found.center[shown])
    truth = view.instances.cam_from_obj[view.instances.visibility_geometric >= LEAST_VISIBILITY]
    picture = draw_poses(view.depth, frames.stored_camera, frames.model, truth, WHITE, scale=scale)
    picture = draw_poses(view.depth, frames.stored_camera, frames.model, predicted, GREEN, scale=scale, canvas=picture)
    return np.ascontiguousarray(picture[..., ::-1])
