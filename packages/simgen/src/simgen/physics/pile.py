"""A pile: instances dropped into a bin until they rest; redone where one of them leaves it or creeps on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from simgen.config_sections import BinSize, PhysicsConfig, PileConfig
from simgen.physics.bin_size import DEFAULT_PILE
from simgen.physics.body import Body
from simgen.physics.engines import world_of
from simgen.physics.settling import random_quaternions, settle

Array = NDArray[np.float64]
COUNT_STAGE, DROP_STAGE = 2, 0  # second word of the spawn key; viewpoints use another


@dataclass(frozen=True, eq=False)
class Pile:
    """Instances at rest: `world_from_obj` (n, 4, 4) in meters, and how many draws it took."""

    world_from_obj: Array
    attempts: int


def simulate_pile(
    body: Body,
    size: BinSize,
    instances: tuple[int, int],
    config: PhysicsConfig,
    seed: int,
    scene: int,
    start: PileConfig = DEFAULT_PILE,
) -> Pile:
    """Drop a random number of instances within `instances` (smallest, largest) into the bin.

    The same arguments give the same bits, whatever this process simulated before. A drop that does not come to rest,
    or in which an instance leaves the bin, is thrown away, and the scene redone from its next draw; with as many
    instances, or full bins would become rare.

    Raises:
        InputError: none of `config.max_attempts` draws came to rest inside the bin.
    """
    count = int(_generator(seed, scene, COUNT_STAGE).integers(instances[0], instances[1] + 1))
    for attempt in range(config.max_attempts):
        rng, again = _generator(seed, scene, DROP_STAGE, attempt), _generator(seed, scene, DROP_STAGE, attempt, 1)
        above, share = _start(_generator(seed, scene, DROP_STAGE, attempt, 0), start)
        over = replace(size, width=share * size.width, depth=share * size.depth).times(body.scale)
        centers, quaternions = _staggered_columns(rng, count, body.radius, over)
        with world_of(body, replace(size, walls=True), config) as world:
            world.drop(centers + np.array([0.0, 0.0, 2 * body.radius * above]), quaternions)
            if not settle(world, again):
                continue
            if not size.walls:
                world.lift_walls()
                if not settle(world, again):
                    continue
            return Pile(world.world_from_obj(), attempt + 1)
    raise InputError(
        f"scene {scene}: none of {config.max_attempts} drops of {count} instances came to rest "
        f"inside the bin of {size} m; give a larger --bin or fewer --instances."
    )


def _generator(*key: int) -> np.random.Generator:
    """The stream of (seed, scene, stage, ...): no other part of a build draws from it."""
    return np.random.default_rng(np.random.SeedSequence(key[0], spawn_key=key[1:]))


def _start(rng: np.random.Generator, config: PileConfig) -> tuple[float, float]:
    """How many diameters higher than they need to instances start, and over which share of the bin's sides."""
    return float(rng.uniform(0, config.drop_height_max)), float(rng.uniform(config.drop_spread_min, 1))


def _staggered_columns(rng: np.random.Generator, count: int, radius: float, size: BinSize) -> tuple[Array, Array]:
    """Centers (n, 3) in columns over the bin, shifted against each other in height, and random quaternions xyzw (n, 4).

    Landing at different times saves the solver the crush of a whole layer at once.
    """
    pitch = 2.05 * radius
    columns = np.maximum((np.array([size.width, size.depth]) / pitch).astype(int), 1)
    slack = (np.array([size.width, size.depth]) - columns * pitch) / 2
    cells = np.array([rng.permutation(columns.prod()) for _ in range(-(-count // columns.prod()))]).ravel()[:count]
    layer = np.arange(count) // columns.prod()
    grid = np.stack(np.divmod(cells, columns[1]), -1)
    ground = (grid - (columns - 1) / 2) * pitch + rng.uniform(-1, 1, (count, 2)) * np.maximum(slack, 0)
    lift = rng.uniform(0, 0.5, columns.prod())[cells]
    height = radius * 1.05 + (layer + lift) * pitch
    return np.column_stack([ground, height]), random_quaternions(rng, count)
