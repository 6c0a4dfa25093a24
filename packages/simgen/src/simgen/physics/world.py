"""One PyBullet world: a bin, and instances that fall into it until they rest."""

from __future__ import annotations

import tempfile
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from simgen.config_sections import BinSize, PhysicsConfig
from simgen.physics.bin_shape import wall_boxes
from simgen.physics.body import Body
from simgen.physics.bullet import pybullet

Array = NDArray[np.float64]
LOOKS_PER_WINDOW = 5
WALL_THICKNESS = 1.0  # in simulated meters, so that nothing tunnels


class World:
    """One PyBullet world, its own client, with a bin; a context manager."""

    def __init__(self, body: Body, size: BinSize, config: PhysicsConfig) -> None:
        self._body, self._size, self._config = body, size.times(body.scale), config
        self._instances: list[int] = []
        self._walls: list[int] = []

    def __enter__(self) -> World:
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet gave no physics client")
        pybullet.setGravity(0, 0, -self._config.gravity, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            physicsClientId=self._client,
        )
        self._add_bin()
        return self

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(physicsClientId=self._client)

    def drop(self, centers: Array, rotations: Array) -> None:
        """Add instances with centers of mass (n, 3), simulated meters, and rotations (n, 3, 3)."""
        shape = self._compound_of_hulls()
        for center, quaternion in zip(centers, _quaternions_xyzw(rotations), strict=True):
            self._instances.append(self._add_body(1.0, shape, center, quaternion))

    def settle(self) -> bool:
        """Simulate until nothing moves throughout the quiet window; False if it takes too long or one is lost.

        Short steps with few iterations while instances fall, or thin ones land in the floor, and are pushed out of it
        sideways or downwards; long steps with many once they only slide and creep.
        """
        config, interval = self._config, self._config.quiet_window / LOOKS_PER_WINDOW
        recent: deque[Array] = deque([self._surface_marks()], maxlen=LOOKS_PER_WINDOW)
        landed = self._free_fall_seconds()
        for look in range(round(config.max_seconds / interval)):
            if look * interval < landed:
                self._simulate(interval, config.fall_time_step, config.fall_iterations)
            else:
                self.rest(interval)
            now = self._surface_marks()
            if not self._all_inside(now):
                return False
            moved = max(float(np.abs(now - before).max()) for before in recent)
            if len(recent) == LOOKS_PER_WINDOW and moved < config.quiet_motion:
                return True
            recent.append(now)
        return False

    def settle_without_walls(self) -> bool:
        """Lift the walls off the settled pile and let it come to rest again, on the bare ground; as :meth:`settle`."""
        for wall in self._walls:
            pybullet.removeBody(wall, physicsClientId=self._client)
        self._walls, self._size = [], replace(self._size, walls=False)
        return self.settle()

    def _free_fall_seconds(self) -> float:
        """When the highest instance is on the floor if nothing is in its way."""
        centers, _ = self._state()
        return float(np.sqrt(2 * max(centers[:, 2].max(), 0.0) / self._config.gravity))

    def rest(self, seconds: float) -> None:
        """Let simulated seconds pass for instances that have settled."""
        self._simulate(seconds, self._config.time_step, self._config.solver_iterations)

    def _simulate(self, seconds: float, time_step: float, solver_iterations: int) -> None:
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=time_step, numSolverIterations=solver_iterations, physicsClientId=self._client
        )
        for _ in range(max(1, round(seconds / time_step))):
            pybullet.stepSimulation(physicsClientId=self._client)

    def world_from_obj(self) -> Array:
        """Poses (n, 4, 4) of the instances, in meters."""
        centers, rotations = self._state()
        origin = centers / self._body.scale - rotations @ self._body.center_of_mass
        return poses.from_rotation_translation(rotations, origin)

    def _state(self) -> tuple[Array, Array]:
        states = [pybullet.getBasePositionAndOrientation(i, physicsClientId=self._client) for i in self._instances]
        return np.array([s[0] for s in states]), poses.from_quaternion_xyzw([s[1] for s in states])

    def _surface_marks(self) -> Array:
        """Each instance's center and the ends of its axes (n, 4, 3): they move as its surface does."""
        centers, rotations = self._state()
        ends = centers[:, None] + self._body.radius * np.swapaxes(rotations, -1, -2)
        return np.concatenate([centers[:, None], ends], 1)

    def _all_inside(self, marks: Array) -> bool:
        centers = marks[:, 0]
        return bool(
            (np.abs(centers[:, :2]) <= self._size.reach).all() and (centers[:, 2] > -self._config.quiet_motion).all()
        )

    def _compound_of_hulls(self) -> int:
        """One shape of all hulls; Bullet makes each object of an OBJ file the convex hull of its vertices."""
        with tempfile.TemporaryDirectory(prefix="simgen-") as folder:
            path = Path(folder) / "hulls.obj"
            path.write_text(_obj_of_hulls(self._body.hulls))
            shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(path), physicsClientId=self._client)
        if shape < 0:
            raise RuntimeError("PyBullet could not make the object's collision shape")
        return int(shape)

    def _add_bin(self) -> None:
        far = 100 * max(self._size.width, self._size.depth)
        floor = np.array([[-far, -far, -WALL_THICKNESS], [far, far, 0.0]])
        self._add_box(floor)
        self._walls = [self._add_box(box) for box in wall_boxes(self._size, WALL_THICKNESS)]

    def _add_box(self, box: Array) -> int:
        half, middle = (box[1] - box[0]) / 2, (box[1] + box[0]) / 2
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half.tolist(), physicsClientId=self._client
        )
        return self._add_body(0.0, shape, middle, np.array([0.0, 0.0, 0.0, 1.0]))

    def _add_body(self, mass: float, shape: int, position: Array, quaternion: Array) -> int:
        body = pybullet.createMultiBody(
            mass,
            shape,
            -1,
            position.tolist(),
            quaternion.tolist(),
            useMaximalCoordinates=True,  # plain rigid bodies: twice as fast as Bullet's articulated ones
            physicsClientId=self._client,
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=self._config.friction,
            rollingFriction=self._config.rolling_friction,
            spinningFriction=self._config.rolling_friction,
            linearDamping=self._config.linear_damping,
            angularDamping=self._config.angular_damping,
            restitution=0.0,
            collisionMargin=self._config.collision_margin,
            physicsClientId=self._client,
        )
        return int(body)


def _obj_of_hulls(hulls: list[Array]) -> str:
    """A Wavefront OBJ with one object a hull; the fan of faces only tells Bullet which vertices belong to it."""
    lines, first = [], 1
    for index, hull in enumerate(hulls):
        lines.append(f"o hull{index}")
        lines += [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in hull]
        lines += [f"f {first} {first + i} {first + i + 1}" for i in range(1, len(hull) - 1)]
        first += len(hull)
    return "\n".join(lines) + "\n"


def _quaternions_xyzw(rotations: Array) -> Array:
    """Rotations (n, 3, 3) to unit quaternions (n, 4): the largest eigenvector of Bar-Itzhack's symmetric matrix."""
    r = rotations
    k = np.empty((len(r), 4, 4))
    k[:, 0, 0] = r[:, 0, 0] - r[:, 1, 1] - r[:, 2, 2]
    k[:, 1, 1] = r[:, 1, 1] - r[:, 0, 0] - r[:, 2, 2]
    k[:, 2, 2] = r[:, 2, 2] - r[:, 0, 0] - r[:, 1, 1]
    k[:, 3, 3] = np.trace(r, axis1=1, axis2=2)
    k[:, 0, 1] = k[:, 1, 0] = r[:, 1, 0] + r[:, 0, 1]
    k[:, 0, 2] = k[:, 2, 0] = r[:, 2, 0] + r[:, 0, 2]
    k[:, 1, 2] = k[:, 2, 1] = r[:, 2, 1] + r[:, 1, 2]
    k[:, 0, 3] = k[:, 3, 0] = r[:, 2, 1] - r[:, 1, 2]
    k[:, 1, 3] = k[:, 3, 1] = r[:, 0, 2] - r[:, 2, 0]
    k[:, 2, 3] = k[:, 3, 2] = r[:, 1, 0] - r[:, 0, 1]
    return np.linalg.eigh(k)[1][..., -1]
