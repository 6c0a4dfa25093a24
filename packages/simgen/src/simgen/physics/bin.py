"""The open bin that instances fall into: its size, and its shape as boxes for physics and renderer alike.

World frame: origin in the middle of the bin's floor, z up.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from simgen.config import BinSize, PileConfig

Array = NDArray[np.float64]
BIN_STAGE = 4  # second word of the spawn key; drops and viewpoints use others
PACKING = 0.6  # share of the bin's volume that convex hulls fill at most: round things would roll off a higher pile
MIN_SIDE = 1.5  # in object diameters
WALL_THICKNESS = 0.03  # of the longer side
GROUND = 4.0  # half-side of the ground around the bin, in longer sides
DEFAULT_PILE = PileConfig()


def fitting_bin(vertices: ArrayLike, diameter: float, instances: int, pile: PileConfig = DEFAULT_PILE) -> BinSize:
    """The bin in which `instances` objects of that mesh (V, 3) and diameter, in metres, pile up `pile.layers` high.

    What an object covers on average is a quarter of its convex hull's surface (Cauchy 1841). They also have room in
    the smallest of the scenes' bins.
    """
    hull, least = _hull(vertices), 1 - pile.bin_jitter
    height = pile.wall_height * diameter
    floor = instances * max(hull.area / 4 / pile.layers, hull.volume / (PACKING * height * least**2))
    sides = math.sqrt(floor) * np.array([math.sqrt(pile.aspect), 1 / math.sqrt(pile.aspect)])
    width, depth = np.maximum(sides, MIN_SIDE * diameter / least)
    return BinSize(float(width), float(depth), height)


def smallest_bin(pile: PileConfig, size: BinSize) -> BinSize:
    """The smallest bin that a scene of a dataset whose bin is `size` may have."""
    least = 1 - pile.bin_jitter
    return replace(size, width=least * size.width, depth=least * size.depth)


def scene_bin(pile: PileConfig, size: BinSize, seed: int, scene: int) -> BinSize:
    """The bin of one scene of a dataset whose bin is `size`: the same for whoever simulates and whoever renders it."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(scene, BIN_STAGE)))
    width, depth = np.array([size.width, size.depth]) * rng.uniform(1 - pile.bin_jitter, 1 + pile.bin_jitter, 2)
    walls = size.walls and bool(rng.random() < pile.wall_probability)
    return BinSize(float(width), float(depth), size.height, walls)


def recorded_bin(config: dict[str, Any], scene: int) -> BinSize | None:
    """The bin of one scene, by the config that its shard carries; None where that tells of no bin."""
    try:
        pile, size = PileConfig(**config["pile"]), BinSize(**config["bin"])
        return scene_bin(pile, size, config["seed"], scene)
    except (KeyError, TypeError, ValueError):
        return None


def fill_level(vertices: ArrayLike, size: BinSize, instances: int) -> float:
    """Volume of the convex hulls of `instances` meshes (V, 3) over the bin's."""
    return float(instances * _hull(vertices).volume / (size.width * size.depth * size.height))


def _hull(vertices: ArrayLike) -> ConvexHull:
    return ConvexHull(vertices, qhull_options="QJ")  # joggled, for flat objects have hulls as well


def wall_boxes(size: BinSize, thickness: float) -> Array:
    """The walls as axis-aligned boxes (4 or 0, 2, 3): smallest and largest corner, in metres."""
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
    """Metres from the bin's middle to the edge of the ground it stands on."""
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
