"""What a frame shows of each instance: visibility, boxes, center."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Instances
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.rendering.rasterizer import Rendering


def quantized(depth: NDArray[np.float32], depth_unit: float) -> NDArray[np.uint16]:
    """Axial meters (H, W) to steps of `depth_unit`; 0, no return, for what is beyond the 16 bits."""
    steps = np.rint(depth * np.float32(1 / depth_unit))
    steps[steps > np.iinfo(np.uint16).max] = 0
    return steps.astype(np.uint16)


def label_instances(
    rendering: Rendering,
    depth_raw: NDArray[np.uint16],
    cam_from_obj: NDArray[np.float64],
    model: ObjectModel,
    camera: Camera,
) -> Instances:
    """Labels of all n instances, the hidden ones too.

    Args:
        rendering: ids and whole silhouettes.
        depth_raw: (H, W) the depth as stored; a pixel without a return is not visible.
        cam_from_obj: (n, 4, 4).
    """
    visible, box_visible = _visible(rendering.instance_id, depth_raw, len(cam_from_obj))
    full = rendering.pixels_full
    return Instances(
        instance=np.arange(len(cam_from_obj), dtype=np.int32),
        cam_from_obj=cam_from_obj,
        visibility=(visible / np.maximum(full, 1)).astype(np.float32),
        pixels_visible=visible,
        pixels_full=full,
        box_visible=box_visible,
        box_full=rendering.box_full,
        center_px=camera.project(model.centers(cam_from_obj)).astype(np.float32),
    )


@numba.njit(cache=True, nogil=True)
def _visible(ids, depth_raw, count):  # type: ignore[no-untyped-def]
    """Pixels (count,) and boxes (count, 4) of each id whose depth has a return."""
    pixels, boxes = np.zeros(count, np.int32), np.zeros((count, 4), np.int32)
    for v in range(ids.shape[0]):
        for u in range(ids.shape[1]):
            row = np.int64(ids[v, u]) - 1
            if row < 0 or depth_raw[v, u] == 0:
                continue
            box = boxes[row]
            if pixels[row] == 0:
                box[0], box[1] = u, v
            box[0], box[2], box[3] = min(box[0], u), max(box[2], u + 1), v + 1
            pixels[row] += 1
    return pixels, boxes
