"""Instances falling into a bin until they rest: PyBullet in, `world_from_obj` out."""

from __future__ import annotations

import tempfile
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from simgen.config import BinSize, PhysicsConfig, PileConfig
from simgen.physics.bin import DEFAULT_PILE, wall_boxes
from simgen.physics.bullet import pybullet

Array = NDArray[np.float64]
Part = tuple[NDArray[np.float64], NDArray[np.int32]]
COUNT_STAGE, DROP_STAGE = 2, 0  # second word of the spawn key; viewpoints use another
LOOKS_PER_WINDOW = 5
WALL_THICKNESS = 1.0  # in simulated metres, so that nothing tunnels


@dataclass(frozen=True, eq=False)
class Body:
    """The object as physics wants it: hulls about its centre of mass, scaled.

    Attributes:
        hulls: (V_i, 3) vertices of each convex part, in simulated metres about the centre of mass.
        center_of_mass: (3,) in the object's frame, metres.
        radius: of the sphere around the centre of mass that holds all hulls, simulated metres.
        scale: simulated metres per metre.
    """

    hulls: list[Array]
    center_of_mass: Array
    radius: float
    scale: float

    @classmethod
    def from_parts(cls, parts: list[Part], simulated_diameter: float) -> Body:
        """From convex parts (vertices (V, 3), faces (F, 3)) in metres, object frame."""
        center = center_of_mass(parts)
        radius = max(float(np.linalg.norm(vertices - center, axis=1).max()) for vertices, _ in parts)
        scale = simulated_diameter / (2 * radius)
        hulls = [(np.asarray(vertices, float) - center) * scale for vertices, _ in parts]
        return cls(hulls, center, radius * scale, scale)


@dataclass(frozen=True, eq=False)
class Pile:
    """Instances at rest: `world_from_obj` (n, 4, 4) in metres, and how many draws it took."""

    world_from_obj: Array
    attempts: int


def center_of_mass(parts: list[Part]) -> Array:
    """Volume-weighted centroid (3,) of convex parts; of their surfaces' vertices where they are flat."""
    volumes, centroids = zip(*(_volume_and_centroid(*part) for part in parts), strict=True)
    if sum(volumes) <= 0:
        return np.asarray(np.concatenate([vertices for vertices, _ in parts]).mean(0))
    return np.average(np.array(centroids), axis=0, weights=np.array(volumes))


def _volume_and_centroid(vertices: Array, faces: NDArray[np.int32]) -> tuple[float, Array]:
    middle = vertices.mean(0)
    corners = vertices[faces] - middle
    volumes = np.abs(np.linalg.det(corners)) / 6  # the middle is inside: the part is convex
    total = float(volumes.sum())
    if total <= 0:
        return 0.0, middle
    return total, middle + np.einsum("f,fki->i", volumes, corners) / (4 * total)


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
        rng = _generator(seed, scene, DROP_STAGE, attempt)
        with World(body, replace(size, walls=True), config) as world:
            above, share = _start(_generator(seed, scene, DROP_STAGE, attempt, 0), start)
            over = replace(size, width=share * size.width, depth=share * size.depth).times(body.scale)
            centers, rotations = _staggered_columns(rng, count, body.radius, over)
            world.drop(centers + np.array([0.0, 0.0, 2 * body.radius * above]), rotations)
            if world.settle() and (size.walls or world.settle_without_walls()):
                return Pile(world.world_from_obj(), attempt + 1)
    raise InputError(
        f"scene {scene}: none of {config.max_attempts} drops of {count} instances came to rest "
        f"inside the bin of {size} m; give a larger --bin or fewer --instances."
    )


def _generator(*key: int) -> np.random.Generator:
    """The stream of (seed, scene, stage, ...): no other part of a build draws from it."""
    return np.random.default_rng(np.random.SeedSequence(key[0], spawn_key=key[1:]))


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
        """Add instances with centres of mass (n, 3), simulated metres, and rotations (n, 3, 3)."""
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
        """Poses (n, 4, 4) of the instances, in metres."""
        centers, rotations = self._state()
        origin = centers / self._body.scale - rotations @ self._body.center_of_mass
        return poses.from_rotation_translation(rotations, origin)

    def _state(self) -> tuple[Array, Array]:
        states = [pybullet.getBasePositionAndOrientation(i, physicsClientId=self._client) for i in self._instances]
        return np.array([s[0] for s in states]), poses.from_quaternion_xyzw([s[1] for s in states])

    def _surface_marks(self) -> Array:
        """Each instance's centre and the ends of its axes (n, 4, 3): they move as its surface does."""
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


def _start(rng: np.random.Generator, config: PileConfig) -> tuple[float, float]:
    """How many diameters higher than they need to instances start, and over which share of the bin's sides."""
    return float(rng.uniform(0, config.drop_height_max)), float(rng.uniform(config.drop_spread_min, 1))


def _staggered_columns(rng: np.random.Generator, count: int, radius: float, size: BinSize) -> tuple[Array, Array]:
    """Centres (n, 3) in columns over the bin, shifted against each other in height, and random rotations (n, 3, 3).

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
    return np.column_stack([ground, height]), poses.random_rotations(rng, count)


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
