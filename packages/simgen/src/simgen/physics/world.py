"""The world that instances fall in, whichever engine computes it: a bin, and instances that are dropped into it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from simgen.config_sections import BinSize, PhysicsConfig
from simgen.physics.body import Body

Array = NDArray[np.float64]
THIN = 0.08  # over the diameter: falls in shorter steps
VERY_THIN = 0.03  # the same: rests in shorter steps too
WALL_THICKNESS = 10.0  # in object diameters, so that nothing tunnels


class World(ABC):
    """A bin and the instances in it; a context manager. All lengths here are simulated meters.

    Attributes:
        body: what falls.
        size: of the bin, simulated meters; without walls once they are lifted off.
        config: how it falls.
    """

    def __init__(self, body: Body, size: BinSize, config: PhysicsConfig) -> None:
        self.body, self.size, self.config = body, size.times(body.scale), config

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    @abstractmethod
    def drop(self, centers: Array, quaternions: Array) -> None:
        """Add instances with centers of mass (n, 3) and unit quaternions xyzw (n, 4)."""

    @abstractmethod
    def put(self, index: int, center: Array, quaternion: Array) -> None:
        """Take an instance out of the heap and drop it from elsewhere: center of mass (3,), quaternion xyzw (4,)."""

    @abstractmethod
    def simulate(self, seconds: float, time_step: float, solver_iterations: int) -> None:
        """Let simulated seconds pass."""

    @abstractmethod
    def state(self) -> tuple[Array, Array]:
        """Centers of mass (n, 3) and unit quaternions xyzw (n, 4) of all instances."""

    def hold(self, still: NDArray[np.bool_]) -> None:
        """Do not compute the motion of those instances (n,) until they are let go; nothing where that saves nothing."""
        return None

    def touching(self) -> NDArray[np.int64]:
        """Pairs of instances (k, 2) that touch; none of an engine that holds nothing."""
        return np.zeros((0, 2), np.int64)

    @abstractmethod
    def _remove_walls(self) -> None: ...

    def lift_walls(self) -> None:
        """Lift the walls off, and leave the instances on the bare ground."""
        self._remove_walls()
        self.size = replace(self.size, walls=False)

    def fall(self, seconds: float) -> None:
        """Let simulated seconds pass for instances in flight.

        Short steps with few iterations: with longer ones thin instances land within the floor, and are pushed out of
        it sideways or downwards.
        """
        thin = self.body.thickness < THIN
        step = self.config.thin_fall_time_step if thin else self.config.fall_time_step
        self.simulate(seconds, step, self.config.fall_iterations)

    def rest(self, seconds: float) -> None:
        """Let simulated seconds pass for instances that only slide and creep."""
        very_thin = self.body.thickness < VERY_THIN
        step = self.config.thin_time_step if very_thin else self.config.time_step
        self.simulate(seconds, step, self.config.solver_iterations)

    def marks(self) -> Array:
        """Each instance's center and its outermost points (n, 1 + k, 3)."""
        centers, quaternions = self.state()
        marks = np.concatenate([np.zeros((1, 3)), self.body.outermost])
        return poses.apply(poses.from_rotation_translation(poses.from_quaternion_xyzw(quaternions), centers), marks)

    def lowest(self) -> Array:
        """Height of each instance's lowest point (n,)."""
        centers, quaternions = self.state()
        down = poses.from_quaternion_xyzw(quaternions)[:, 2]
        return np.asarray(poses.compose(down, np.concatenate(self.body.hulls).T).min(1) + centers[:, 2])

    def world_from_obj(self) -> Array:
        """Poses (n, 4, 4) of the instances, in meters."""
        centers, quaternions = self.state()
        rotations = poses.from_quaternion_xyzw(quaternions)
        origin = centers / self.body.scale - np.einsum("nij,j->ni", rotations, self.body.center_of_mass)
        return poses.from_rotation_translation(rotations, origin)
