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
        depth_raw: (H, W) the depth as stored.
        cam_from_obj: (n, 4, 4).
    """
    geometric, returned, box_returned = _seen(rendering.instance_id, depth_raw, len(cam_from_obj))
    full = rendering.pixels_full
    return Instances(
        instance=np.arange(len(cam_from_obj), dtype=np.int32),
        cam_from_obj=cam_from_obj,
        visibility_geometric=(geometric / np.maximum(full, 1)).astype(np.float32),
        visibility_returned=(returned / np.maximum(full, 1)).astype(np.float32),
        pixels_geometric=geometric,
        pixels_returned=returned,
        pixels_full=full,
        box_returned=box_returned,
        box_full=rendering.box_full,
        center_px=camera.project(model.centers(cam_from_obj)).astype(np.float32),
    )


@numba.njit(cache=True, nogil=True)
def _seen(ids, depth_raw, count):  # type: ignore[no-untyped-def]
    """Of each id its pixels (count,), those whose depth has a return (count,), and the box (count, 4) of the latter."""
    pixels, returned, boxes = np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros((count, 4), np.int32)
    for v in range(ids.shape[0]):
        for u in range(ids.shape[1]):
            row = np.int64(ids[v, u]) - 1
            if row < 0:
                continue
            pixels[row] += 1
            if depth_raw[v, u] == 0:
                continue
            box = boxes[row]
            if returned[row] == 0:
                box[0], box[1] = u, v
            box[0], box[2], box[3] = min(box[0], u), max(box[2], u + 1), v + 1
            returned[row] += 1
    return pixels, returned, boxes
