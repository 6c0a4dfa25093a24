"""Everything between a depth image and its scored poses, kept for the eye."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from evalkit.datasets.scene import View
from evalkit.drawing.overlays import draw_poses, shade
from evalkit.errors import InputError
from posenet.coding import euler
from posenet.detectors.base import Detections
from posenet.network.depth_input import intrinsics_of, resample
from posenet.network.hypotheses import Hypotheses
from posenet.network.pose_heads import PoseOutputs
from posenet.network.pose_network import PoseNetwork

# Rank of a hypothesis in its detection to a color, RGB; the color-blind see the difference too (Wong 2011).
COLORS = ((0, 158, 115), (230, 159, 0), (86, 180, 233), (204, 121, 167), (240, 228, 66))
SCALE = 4  # pictures are so much larger than the depth image


@dataclass(frozen=True, eq=False)
class LookedAt:
    """One frame, the n detections of the network on it, what was read off them and the H hypotheses that follow."""

    network: PoseNetwork
    view: View
    outputs: PoseOutputs
    hypotheses: Hypotheses
    detections: Detections
    logit: Tensor  # (H,) of the confidence
    score: NDArray[np.float64]  # (H,) final, 0 to 1

    @property
    def angles(self) -> Tensor:
        """a, b, c (H, 3) of the hypotheses, of all equivalent ones those that the bins are made for."""
        return torch.stack(euler.to_angles(self.network.codec.canonical_label(self.hypotheses.relative)), -1)

    def of_detection(self, row: int) -> list[int]:
        """Rows of the hypotheses of one detection, best product first."""
        return [int(i) for i in (self.hypotheses.detection == row).nonzero()[:, 0]]

    def poses(self, rows: list[int]) -> NDArray[np.float64]:
        shown = self.hypotheses.select(torch.tensor(rows))
        return self.network.codec.cam_from_obj(shown.rotation, shown.center)

    def picture(self, groups: list[list[int]]) -> NDArray[np.uint8]:
        """The depth image with hypotheses' contours (SCALE H, SCALE W, 3), RGB; colors by rank in each group."""
        view, model = self.view, self.network.model
        canvas = shade(view.depth, view.camera, SCALE)
        for rows in groups:
            bgr = [(b, g, r) for r, g, b in COLORS[: len(rows)]]
            canvas = draw_poses(view.depth, view.camera, model, self.poses(rows[::-1]), bgr[::-1], SCALE, 2, canvas)
        return np.ascontiguousarray(canvas[..., ::-1])


@torch.no_grad()
def look_at(network: PoseNetwork, view: View) -> LookedAt:
    """Run the network (on the CPU) on a frame of its own kind of shards.

    Raises:
        InputError: the camera is not the one that the network was trained with, or nothing is found.
    """
    view = _as_trained(view, network)
    depth, intrinsics = torch.from_numpy(view.depth)[None], intrinsics_of(view.camera)[None]
    with network.predicting(bf16=False):
        (proposals,) = network.propose(network.encode(depth, intrinsics))
        scored = network.score(proposals)
    detections, outputs, hypotheses = proposals[:3]
    if len(hypotheses) == 0:
        raise InputError(f"image '{view.image_id}': the model finds nothing there; give another --frame.")
    score = network.final_logit(scored.confidence, scored.registered).sigmoid().double().numpy()
    return LookedAt(network, view, outputs, hypotheses, detections, scored.confidence, score)


def _as_trained(view: View, network: PoseNetwork) -> View:
    """The frame on the pixel grid that the network was trained on."""
    camera = network.camera
    if camera not in (view.camera, view.camera.sampled(camera.width, camera.height)):
        raise InputError(f"image '{view.image_id}' is of another camera than the model's; draw on shards of its own.")
    raw, ids = (resample(torch.from_numpy(image), camera).numpy() for image in (view.depth_raw, view.instance_id))
    return replace(view, camera=camera, depth_raw=raw, instance_id=ids, depth_ideal_raw=None)
