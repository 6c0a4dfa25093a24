"""The world as PyBullet computes it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgen.config_sections import BinSize, PhysicsConfig
from simgen.physics.bin_shape import wall_boxes
from simgen.physics.body import Body
from simgen.physics.bullet import pybullet
from simgen.physics.world import WALL_THICKNESS, World

Array = NDArray[np.float64]
MASS = 1.0  # of an instance


class BulletWorld(World):
    """A client of PyBullet's own, so that no world knows of another."""

    def __init__(self, body: Body, size: BinSize, config: PhysicsConfig) -> None:
        super().__init__(body, size, config)
        self._instances: list[int] = []
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet gave no physics client")
        pybullet.setGravity(0, 0, -self.config.gravity, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, physicsClientId=self._client)
        self._walls = self._add_bin()

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(physicsClientId=self._client)

    def drop(self, centers: Array, quaternions: Array) -> None:
        shape = self._compound_of_hulls()
        for center, quaternion in zip(centers, quaternions, strict=True):
            self._instances.append(self._add_body(MASS, shape, center, quaternion))
        self._held: NDArray[np.bool_] = np.zeros(len(self._instances), bool)

    def hold(self, still: NDArray[np.bool_]) -> None:
        for index in np.flatnonzero(still != self._held):
            held, body = bool(still[index]), self._instances[index]
            pybullet.resetBaseVelocity(body, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], physicsClientId=self._client)
            pybullet.changeDynamics(
                body,
                -1,
                mass=0.0 if held else MASS,  # of no mass is what stands still; two of them are not tested for contact
                activationState=pybullet.ACTIVATION_STATE_SLEEP if held else pybullet.ACTIVATION_STATE_WAKE_UP,
                physicsClientId=self._client,
            )
        self._held = still.copy()

    def touching(self) -> NDArray[np.int64]:
        points = pybullet.getContactPoints(physicsClientId=self._client)
        pairs = np.array([point[1:3] for point in points], np.int64).reshape(-1, 2) - self._instances[0]
        return pairs[((pairs >= 0) & (pairs < len(self._instances))).all(1)]  # bodies are numbered as they are added

    def put(self, index: int, center: Array, quaternion: Array) -> None:
        self.hold(self._held & (np.arange(len(self._held)) != index))
        body = self._instances[index]
        pybullet.resetBasePositionAndOrientation(
            body, center.tolist(), quaternion.tolist(), physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(body, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], physicsClientId=self._client)

    def simulate(self, seconds: float, time_step: float, solver_iterations: int) -> None:
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=time_step, numSolverIterations=solver_iterations, physicsClientId=self._client
        )
        for _ in range(max(1, round(seconds / time_step))):
            pybullet.stepSimulation(physicsClientId=self._client)

    def state(self) -> tuple[Array, Array]:
        states = [pybullet.getBasePositionAndOrientation(i, physicsClientId=self._client) for i in self._instances]
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def _remove_walls(self) -> None:
        for wall in self._walls:
            pybullet.removeBody(wall, physicsClientId=self._client)
        self._walls = []

    def _compound_of_hulls(self) -> int:
        """One shape of all hulls; Bullet makes each object of an OBJ file the convex hull of its vertices."""
        with tempfile.TemporaryDirectory(prefix="simgen-") as folder:
            path = Path(folder) / "hulls.obj"
            path.write_text(_obj_of_hulls(self.body.hulls))
            shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(path), physicsClientId=self._client)
        if shape < 0:
            raise RuntimeError("PyBullet could not make the object's collision shape")
        return int(shape)

    def _add_bin(self) -> list[int]:
        far, thickness = 100 * max(self.size.width, self.size.depth), WALL_THICKNESS * self.config.simulated_diameter
        floor = np.array([[-far, -far, -thickness], [far, far, 0.0]])
        self._add_box(floor)
        return [self._add_box(box) for box in wall_boxes(self.size, thickness)]

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
            lateralFriction=self.config.friction,
            rollingFriction=self.config.rolling_friction,
            spinningFriction=self.config.rolling_friction,
            linearDamping=self.config.linear_damping,
            angularDamping=self.config.angular_damping,
            restitution=0.0,
            collisionMargin=self.config.contact_margin,
            frictionAnchor=1,  # or contacts drift, until what stands unsteadily tips over after all
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
