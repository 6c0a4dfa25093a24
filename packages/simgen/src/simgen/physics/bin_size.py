"""How large the open bin is that instances fall into: the dataset's, and each scene's."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from evalkit.errors import InputError
from evalkit.objects.model import ObjectModel
from simgen.config_sections import BinSize, PileConfig

BIN_STAGE = 4  # second word of the spawn key; drops and viewpoints use others
PACKING = 0.6  # share of the bin's volume that convex hulls fill at most: round things would roll off a higher pile
MAX_FILL = 1.5  # of the bin's volume by convex hulls: heaps rise above the walls, but no higher
MIN_SIDE = 1.5  # in object diameters
DEFAULT_PILE = PileConfig()


def fitting_bin(vertices: ArrayLike, diameter: float, instances: int, pile: PileConfig = DEFAULT_PILE) -> BinSize:
    """The bin in which `instances` objects of that mesh (V, 3) and diameter, in meters, pile up `pile.layers` high.

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
    """The bin of one scene, by the config that its shard carries; None where that names no bin."""
    try:
        pile, size = PileConfig(**config["pile"]), BinSize(**config["bin"])
        return scene_bin(pile, size, config["seed"], scene)
    except (KeyError, TypeError, ValueError):
        return None


def fill_level(vertices: ArrayLike, size: BinSize, instances: int) -> float:
    """Volume of the convex hulls of `instances` meshes (V, 3) over the bin's."""
    return float(instances * _hull(vertices).volume / (size.width * size.depth * size.height))


def require_room(pile: PileConfig, size: BinSize, model: ObjectModel, instances: int) -> None:
    """Refuse a bin too small for the object, or for `instances` of it, in any scene.

    Raises:
        InputError: the sentence names the option.
    """
    smallest = smallest_bin(pile, size)
    jitter = "" if smallest == size else f" less --bin-jitter {pile.bin_jitter:g}"
    if min(smallest.width, smallest.depth) < model.diameter:
        raise InputError(
            f"--bin {size}{jitter}: the object '{model.title}' is {model.diameter:g} m across; "
            "give a bin whose width and depth are larger, in meters, or --bin auto."
        )
    if fill_level(model.mesh[0], smallest, instances) > MAX_FILL:
        raise InputError(
            f"--bin {size}{jitter}: {instances} instances of '{model.title}' do not fit into it; "
            "give a larger --bin in meters or fewer --instances."
        )


def _hull(vertices: ArrayLike) -> ConvexHull:
    return ConvexHull(vertices, qhull_options="QJ")  # joggled, for flat objects have hulls as well
