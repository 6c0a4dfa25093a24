"""The world as Rapier computes it, through its own Python bindings. In float32, the same for any number of threads."""

from __future__ import annotations

import numpy as np
import rapier3d
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from simgen.config_sections import BinSize, PhysicsConfig
from simgen.physics.bin_shape import wall_boxes
from simgen.physics.body import Body
from simgen.physics.world import WALL_THICKNESS, World

Array = NDArray[np.float64]
MASS = 1.0  # of an instance: in single precision contacts do not hold what weighs a hundred-thousandth of that
FRICTION_RULE = rapier3d.CoefficientCombineRule.MULTIPLY  # as Bullet combines two surfaces'


class RapierWorld(World):
    """Bodies of one collider a hull: Rapier is faster with them than with one compound."""

    def __init__(self, body: Body, size: BinSize, config: PhysicsConfig) -> None:
        super().__init__(body, size, config)
        self._world = rapier3d.PhysicsWorld(gravity=(0.0, 0.0, -config.gravity))
        self._world.set_num_threads(1)  # workers are processes
        parameters = self._world.integration_parameters
        parameters.length_unit = config.simulated_diameter
        parameters.contact_softness = parameters.static_contact_softness = rapier3d.SpringCoefficients(
            config.contact_frequency, config.contact_damping_ratio
        )
        self._instances: list[rapier3d.RigidBodyHandle] = []
        ground = self._world.add_body(rapier3d.RigidBody.fixed())
        self._world.add_collider(self._material(rapier3d.Collider.halfspace((0.0, 0.0, 1.0))), ground)
        self._walls = self._world.add_body(rapier3d.RigidBody.fixed())
        for low, high in wall_boxes(self.size, WALL_THICKNESS * config.simulated_diameter):
            box = rapier3d.Collider.cuboid(*((high - low) / 2).tolist())
            middle = tuple(((high + low) / 2).tolist())
            self._world.add_collider(self._material(box.translation(middle)), self._walls)

    def drop(self, centers: Array, quaternions: Array) -> None:
        hulls = [hull.astype(np.float32) for hull in self.body.hulls]
        density = MASS / sum(ConvexHull(hull, qhull_options="QJ").volume for hull in self.body.hulls)
        for center, quaternion in zip(centers, quaternions, strict=True):
            builder = rapier3d.RigidBody.dynamic().position(_isometry(center, quaternion))
            builder = builder.linear_damping(self.config.linear_damping).angular_damping(self.config.angular_damping)
            colliders: list[rapier3d.Collider | rapier3d.ColliderBuilder] = [
                self._material(rapier3d.Collider.convex_hull(hull)).density(density) for hull in hulls
            ]
            self._instances.append(self._world.add_body(builder, colliders))

    def put(self, index: int, center: Array, quaternion: Array) -> None:
        body = self._world.rigid_bodies[self._instances[index]]
        body.position = _isometry(center, quaternion)
        body.linvel, body.angvel = rapier3d.Vec3(0.0, 0.0, 0.0), rapier3d.Vec3(0.0, 0.0, 0.0)
        self._world.wake_up(self._instances[index])

    def simulate(self, seconds: float, time_step: float, solver_iterations: int) -> None:
        parameters = self._world.integration_parameters
        parameters.dt, parameters.num_solver_iterations = time_step, solver_iterations
        for _ in range(max(1, round(seconds / time_step))):
            self._world.step()

    def state(self) -> tuple[Array, Array]:
        bodies = [self._world.rigid_bodies[handle] for handle in self._instances]
        positions = [(body.translation, body.rotation) for body in bodies]
        centers = np.array([(t.x, t.y, t.z) for t, _ in positions], float)
        return centers, np.array([(q.i, q.j, q.k, q.w) for _, q in positions], float)

    def _remove_walls(self) -> None:
        self._world.remove_body(self._walls)
        self._world.wake_up_all()

    def _material(self, collider: rapier3d.ColliderBuilder) -> rapier3d.ColliderBuilder:
        collider = collider.friction(self.config.friction).friction_combine_rule(FRICTION_RULE)
        return collider.restitution(0.0).contact_skin(self.config.contact_margin)


def _isometry(center: Array, quaternion: Array) -> rapier3d.Isometry3:
    x, y, z, w = quaternion.tolist()
    return rapier3d.Isometry3(rapier3d.Vec3(*center.tolist()), rapier3d.Rotation3(w, x, y, z))
