"""The shape of the open bin and the ground it stands on: boxes for physics, triangles for the renderers.

World frame: origin in the middle of the bin's floor, z up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgen.config_sections import BinSize

Array = NDArray[np.float64]
WALL_THICKNESS = 0.03  # of the longer side
GROUND = 4.0  # half-side of the ground around the bin, in longer sides


def wall_boxes(size: BinSize, thickness: float) -> Array:
    """The walls as axis-aligned boxes (4 or 0, 2, 3): smallest and largest corner, in meters."""
    if not size.walls:
        return np.zeros((0, 2, 3))
    x, y, z, t = size.width / 2, size.depth / 2, size.height, thickness
    return np.array(
        [
            [[x, -y - t, 0], [x + t, y + t, z]],
            [[-x - t, -y - t, 0], [-x, y + t, z]],
            [[-x, y, 0], [x, y + t, z]],
            [[-x, -y - t, 0], [x, -y, z]],
        ]
    )


def ground_half_side(size: BinSize) -> float:
    """Meters from the bin's middle to the edge of the ground it stands on."""
    return GROUND * max(size.width, size.depth)


def bin_mesh(size: BinSize) -> tuple[Array, NDArray[np.int32]]:
    """Walls and ground as triangles: vertices (V, 3) in the world frame and faces (F, 3)."""
    boxes = wall_boxes(size, WALL_THICKNESS * max(size.width, size.depth))
    corner = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])
    vertices = [np.take_along_axis(box, corner, axis=0) for box in boxes]
    faces = [_BOX_FACES + 8 * index for index in range(len(boxes))]
    half = ground_half_side(size)
    vertices.append(np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]))
    faces.append(np.array([[0, 1, 2], [0, 2, 3]]) + 8 * len(boxes))
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
