"""How good a pile is: how deep its instances are in each other and in the floor, and how far they still move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from evalkit.geometry import poses
from simgen.config_sections import PhysicsConfig
from simgen.physics.body import Body
from simgen.physics.engines import world_of
from simgen.scenes.job import Job

Array = NDArray[np.float64]
SECONDS_AFTERWARDS = 2.0
EVERY_VERTEX = 7  # of the mesh, for motion


@dataclass(frozen=True, eq=False)
class Hulls:
    """An object's convex parts: all vertices (V, 3), and each part's planes (F, 4), outward, meters."""

    vertices: Array
    planes: list[Array]


def hulls_of(job: Job) -> Hulls:
    vertices = [np.asarray(part[0], float) for part in job.convex_parts]
    return Hulls(np.concatenate(vertices), [ConvexHull(v, qhull_options="QJ").equations for v in vertices])


def penetrations(hulls: Hulls, world_from_obj: Array) -> Array:
    """Meters that some vertex of an instance is within another, for each pair that is close (pairs,); 0 = not at all.

    What is measured is the convex parts, which is all that physics knows of the object.
    """
    middle = hulls.vertices.mean(0)
    reach = 2 * float(np.linalg.norm(hulls.vertices - middle, axis=1).max())
    centers = poses.apply(world_from_obj, middle[None])[:, 0]
    obj_from_world = poses.invert(world_from_obj)
    found = []
    for i in range(len(centers)):
        for j in range(len(centers)):
            if i != j and np.linalg.norm(centers[i] - centers[j]) < reach:
                points = poses.apply(obj_from_world[j] @ world_from_obj[i], hulls.vertices)
                found.append(max(_depth(points, planes) for planes in hulls.planes))
    return np.array(found)


def _depth(points: Array, planes: Array) -> float:
    """How deep the deepest of points (N, 3) is within a convex part."""
    outside = (points @ planes[:, :3].T + planes[:, 3]).max(1)
    return max(0.0, -float(outside.min()))


def below_floor(hulls: Hulls, world_from_obj: Array) -> Array:
    """Meters that each instance (n,) is in the floor."""
    return np.maximum(0.0, -poses.apply(world_from_obj, hulls.vertices)[..., 2].min(1))


def motion_afterwards(job: Job, scene: int, world_from_obj: Array, physics: PhysicsConfig) -> Array:
    """Meters that the farthest moved vertex of each instance (n,) goes in the next two seconds."""
    body = Body.from_parts(job.convex_parts, physics.simulated_diameter)
    centers = poses.apply(world_from_obj, body.center_of_mass[None])[:, 0]
    with world_of(body, job.scene_bin(scene), physics) as world:
        world.drop(centers * body.scale, poses.to_quaternion_xyzw(world_from_obj[:, :3, :3]))
        world.rest(SECONDS_AFTERWARDS)
        later = world.world_from_obj()
    assert job.model.vertices is not None
    marks = job.model.vertices[::EVERY_VERTEX]
    moved = poses.apply(later, marks) - poses.apply(world_from_obj, marks)
    return np.asarray(np.linalg.norm(moved, axis=-1).max(1))
