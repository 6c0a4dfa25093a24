"""A pose moved to where the depth image has the surface: point-to-plane ICP against traced rays.

How well a surface matches does not say whether its pose is right within a tenth of the diameter: depth cameras are
exact to a tenth of that. So the pose is first fitted; the image then either verifies the fitted pose or not, and how
far it moved says how far off the given one was.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.evidence.ray_tracer import RayTracer
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera

Array = NDArray[np.float64]
ITERATIONS = 10
RAYS = 1500  # of a pose and iteration
REACH = (0.12, 0.03)  # diameters: how far a point is drawn, first and last iteration
FEWEST = 30  # pixels that determine a pose
DAMPING = 1e-3  # keeps still what depth does not determine: a plate along its plane, a bottle about its axis
STILL = 1e-4  # diameters and radians; a step below that is the last


def fitted(
    cam_from_obj: Array,
    tracer: RayTracer,
    depth: NDArray[np.float32],
    camera: Camera,
    center: Array,
    diameter: float,
) -> Array:
    """The pose (4, 4) after point-to-plane ICP (Chen & Medioni 1991) on a depth image (height, width) in meters.

    Where the fit explains the image worse than the pose given, that one is returned: of a thin part seen on its edge
    few pixels hold the pose, and those of its neighbors draw it away.

    Args:
        center: (3,) the point of the object about which steps turn.
    """
    pose = np.array(cam_from_obj, float)
    for reach in np.linspace(*REACH, ITERATIONS) * diameter:
        step = _step(pose, tracer, depth, camera, center, reach, diameter)
        if step is None:
            break
        pose = step @ pose
        pose[:3, :3] = poses.nearest_rotation(pose[:3, :3])
        if np.abs(step - np.eye(4)).max() < STILL * min(1.0, diameter):
            break
    reach = REACH[1] * diameter
    given = np.array(cam_from_obj, float)
    return min((pose, given), key=lambda one: _misfit(one, tracer, depth, camera, reach))


def _misfit(pose: Array, tracer: RayTracer, depth: NDArray[np.float32], camera: Camera, reach: float) -> float:
    """Mean distance between measured and traced depth where nothing hides the part, cut at `reach`, in parts of it."""
    seen = tracer.trace(pose, camera, RAYS)
    measured = np.asarray(depth[seen.v, seen.u], float)
    gap = measured - seen.depth
    counted = (measured > 0) & (gap > -reach)
    return float(np.minimum(np.abs(gap[counted]), reach).mean() / reach) if counted.any() else 1.0


def _step(
    pose: Array,
    tracer: RayTracer,
    depth: NDArray[np.float32],
    camera: Camera,
    center: Array,
    reach: float,
    diameter: float,
) -> Array | None:
    """One Gauss-Newton step (4, 4), on the left of the pose; None where too few pixels agree to make one."""
    seen = tracer.trace(pose, camera, RAYS)
    measured = np.asarray(depth[seen.v, seen.u], float)
    near = (measured > 0) & (np.abs(measured - seen.depth) < reach)
    if near.sum() < FEWEST:
        return None
    ray = np.stack([(seen.u - camera.cx) / camera.fx, (seen.v - camera.cy) / camera.fy, np.ones(len(seen))], -1)[near]
    normal, gap = seen.normal[near], measured[near] - seen.depth[near]
    middle = poses.apply(pose, center[None])[0]
    arm = (ray * seen.depth[near, None] - middle) / diameter
    residual = gap * np.einsum("nk,nk->n", normal, ray) / diameter
    weight = 1.0 / (1.0 + (residual * diameter / (0.3 * reach)) ** 2)
    rows = np.concatenate([np.cross(arm, normal), normal], 1)
    normal_matrix = (rows * weight[:, None]).T @ rows
    damped = normal_matrix + DAMPING * np.trace(normal_matrix) * np.eye(6)
    delta = np.linalg.solve(damped, (rows * weight[:, None]).T @ residual)
    angle = float(np.linalg.norm(delta[:3]))
    axis = delta[:3] / max(angle, 1e-12)
    rotation = poses.from_axis_angle(axis, min(angle, 0.3))
    shift = middle + delta[3:] * diameter - rotation @ middle
    return np.asarray(poses.from_rotation_translation(rotation, shift))
