"""A depth camera's error: from ideal depth to what a triangulating sensor would measure.

Everything happens in disparity, focal * baseline / z, where matching makes its mistakes:

* noise, correlated as far as a matching window reaches, growing with slope;
* shadows: what the second eye does not see, always on the same side of what is nearer;
* failures of matching, in blobs, rare on smooth surface and frequent beside steps;
* wrong patches: around steps, whole windows matched to another place's disparity;
* steps of disparity, and of the depth that is delivered;
* surfaces that lose or bend light by how they are inclined (:mod:`simgen.sensors.surfaces`).

A pixel with a return counts as returned, be the return right or wrong: labels tell which surface lies there, and no
error of the sensor moves an instance.

What is not modeled: the strip of the image that lies outside the second eye's view, texture, motion.
Sources of the parameters are in :mod:`simgen.sensors.sensor_config`.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from simgen.compiled import compiled
from simgen.sensors.random_fields import failure_field, matching_noise
from simgen.sensors.sensor_config import SensorConfig
from simgen.sensors.surfaces import apparent, lost_by_incidence

SENSOR_STAGE = 7  # second word of the spawn key; drops, viewpoints and bins use others
EDGE_REACH = 8  # pixels; farther from a step a surface counts as smooth
CLOSE = 4  # pixels from a step within which wrong patches have their middles
PATCH_RADIUS = (2.0, 5.0)  # pixels, of wrong patches
PATCH_JUMP = 4.0  # pixels beyond its own rim from which a wrong patch may have its disparity

Image = NDArray[np.float32]


def sensor_generator(seed: int, scene: int, view: int) -> np.random.Generator:
    """The randomness of one frame's sensor."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(scene, SENSOR_STAGE, view)))


def measure(depth: Image, camera: Camera, sensor: SensorConfig, rng: np.random.Generator) -> Image:
    """What the sensor measures of an ideal depth image.

    Args:
        depth: (H, W) axial meters, 0 = nothing there.
        camera: the intrinsics, those of both eyes.

    Returns:
        (H, W) axial meters, 0 = no return. Where there is nothing nothing returns.
    """
    scale = camera.fx * abs(sensor.baseline)
    disparity = disparities(depth, scale)
    to_step = distance_to_step(disparity, sensor.step_px)
    wrong = wrong_patches(disparity, to_step, sensor.wrong_patches, rng)
    noise = matching_noise(depth.shape, rng, sensor.noise_blur)
    failure = failure_field(depth.shape, rng)
    seen = apparent(disparity, scale, (camera.fx, camera.fy), sensor)
    slopes = np.array([camera.fx, camera.fy, math.tan(math.radians(min(sensor.steepest_degrees, 89.9)))])
    amount = np.array([sensor.noise_px, sensor.noise_per_slope, sensor.quantum_px, sensor.depth_step])
    limits, shadow = failure_limits(sensor), np.float64(_quantile(sensor.shadow_missing))
    hidden = shadows(disparity) if sensor.baseline > 0 else shadows(disparity[:, ::-1].copy())[:, ::-1].copy()
    return np.asarray(
        _measured(disparity, seen, to_step, hidden, wrong, noise, failure, limits, shadow, slopes, amount, scale)
    )


def failure_limits(sensor: SensorConfig) -> NDArray[np.float64]:
    """Values of :func:`failure_field` below which matching fails (EDGE_REACH + 2, angles).

    For each distance to a step 0 .. EDGE_REACH + 1, and each angle of :func:`lost_by_incidence`.
    """
    reach = np.arange(EDGE_REACH + 1)
    beside = np.append(sensor.edge_missing * np.exp(-np.maximum(reach - 1, 0) / sensor.edge_reach_px), 0.0)
    anywhere = 1 - (1 - sensor.smooth_missing) * (1 - lost_by_incidence(sensor))
    return np.vectorize(_quantile, otypes=[float])(1 - (1 - anywhere) * (1 - beside[:, None]))


def _quantile(share: float) -> float:
    """Below which a standard normal number lies with this probability."""
    if not 0 < share < 1:
        return -math.inf if share <= 0 else math.inf
    return NormalDist().inv_cdf(share)


@compiled
def disparities(depth, scale):  # type: ignore[no-untyped-def]
    """`scale` / depth (H, W), 0 where there is nothing."""
    out = np.zeros(depth.shape, np.float32)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if depth[v, u] > 0:
                out[v, u] = scale / depth[v, u]
    return out


@compiled
def distance_to_step(disparity, step):  # type: ignore[no-untyped-def]
    """Chessboard distance in pixels (H, W) to the other side of the nearest step, at most EDGE_REACH + 1.

    The two pixels of a step, neighbors in a row or a column, are at distance 1.
    """
    height, width = disparity.shape
    out = np.full((height, width), EDGE_REACH + 1, np.uint8)
    for v in range(height):
        for u in range(width):
            if u + 1 < width and abs(disparity[v, u + 1] - disparity[v, u]) > step:
                out[v, u] = out[v, u + 1] = 1
            if v + 1 < height and abs(disparity[v + 1, u] - disparity[v, u]) > step:
                out[v, u] = out[v + 1, u] = 1
    one = np.uint8(1)
    for v in range(height):
        for u in range(width):
            least = out[v, u] - one
            if u > 0:
                least = min(least, out[v, u - 1])
            if v > 0:
                least = min(least, out[v - 1, u], out[v - 1, max(u - 1, 0)], out[v - 1, min(u + 1, width - 1)])
            out[v, u] = least + one
    for v in range(height - 1, -1, -1):
        for u in range(width - 1, -1, -1):
            least = out[v, u] - one
            if u + 1 < width:
                least = min(least, out[v, u + 1])
            if v + 1 < height:
                least = min(least, out[v + 1, u], out[v + 1, max(u - 1, 0)], out[v + 1, min(u + 1, width - 1)])
            out[v, u] = least + one
    return out


@compiled
def shadows(disparity):  # type: ignore[no-untyped-def]
    """Where the second eye, on the right, sees something nearer instead (H, W).

    It sees pixel u of a row at u - disparity; whatever to the right of u it sees at or left of that place is before u.
    """
    height, width = disparity.shape
    out = np.zeros((height, width), np.bool_)
    for v in range(height):
        leftmost = np.float32(np.inf)
        for u in range(width - 1, -1, -1):
            if disparity[v, u] > 0:
                seen_at = np.float32(u) - disparity[v, u]
                out[v, u] = seen_at >= leftmost
                leftmost = min(leftmost, seen_at)
    return out


def wrong_patches(disparity: Image, to_step: NDArray[np.uint8], share: float, rng: np.random.Generator) -> Image:
    """Disparity of patches that are matched to another place's (H, W), 0 where there is none.

    The patches are ellipses whose middles are close to steps; together they have `share` of the area that is.
    """
    out = np.zeros_like(disparity)
    close = np.flatnonzero((to_step <= CLOSE) & (disparity > 0))
    low, high = PATCH_RADIUS
    mean_area = math.pi * ((low + high) / 2) ** 2
    count = int(rng.poisson(share * len(close) / mean_area))
    if count == 0 or len(close) == 0:
        return out
    middles = close[rng.integers(0, len(close), count)]
    radii = rng.uniform(low, high, (count, 2))
    angle, jump = rng.uniform(0, 2 * math.pi, count), rng.uniform(0, PATCH_JUMP, count) + radii.max(1)
    offsets = np.rint(np.stack([jump * np.cos(angle), jump * np.sin(angle)], 1)).astype(np.int64)
    _put_patches(disparity, middles, radii, offsets, out)
    return out


@compiled
def _put_patches(disparity, middles, radii, offsets, out):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for i in range(len(middles)):
        v0, u0 = middles[i] // width, middles[i] % width
        u, v = u0 + offsets[i, 0], v0 + offsets[i, 1]
        if not (0 <= u < width and 0 <= v < height) or disparity[v, u] == 0:
            continue
        value, a, b = disparity[v, u], radii[i, 0], radii[i, 1]
        for v in range(max(0, int(v0 - b)), min(height, int(v0 + b) + 1)):
            for u in range(max(0, int(u0 - a)), min(width, int(u0 + a) + 1)):
                if ((u - u0) / a) ** 2 + ((v - v0) / b) ** 2 <= 1:
                    out[v, u] = value


@compiled
def _measured(disparity, seen, to_step, hidden, wrong, noise, failure, limits, shadow, slopes, amount, scale):  # type: ignore[no-untyped-def]
    """Depth in meters (H, W) from true and wrong disparities, unit noise and where matching fails."""
    height, width = disparity.shape
    fx, fy, steepest = slopes
    noise_px, per_slope, quantum, depth_step = amount
    angles = limits.shape[1]
    out = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            true = disparity[v, u]
            if true == 0:
                continue
            left, right = _neighbors(u, width)
            above, below = _neighbors(v, height)
            across = _gentler(disparity[v, left], true, disparity[v, right])
            down = _gentler(disparity[above, u], true, disparity[below, u])
            slope = math.sqrt((fx * across) ** 2 + (fy * down) ** 2) / true
            if slope > steepest:
                continue
            angle = int(math.degrees(math.atan(slope))) if angles > 1 else 0
            limit = limits[to_step[v, u], angle]
            if failure[v, u] < (max(limit, shadow) if hidden[v, u] else limit):
                continue
            found = wrong[v, u] if wrong[v, u] > 0 else seen[v, u]
            found = found + noise_px * (1 + per_slope * slope) * noise[v, u]
            found = math.floor(found / quantum + 0.5) * quantum
            if found > 0:
                out[v, u] = scale / found
                if depth_step > 0:
                    out[v, u] = math.floor(out[v, u] / depth_step + 0.5) * depth_step
    return out


@compiled
def _neighbors(pixel, count):  # type: ignore[no-untyped-def]
    """The pixels before and after in a row or column; at either end twice the same."""
    before, after = pixel - 1, pixel + 1
    if before < 0:
        before = min(after, count - 1)
    if after == count:
        after = before
    return before, after


@compiled
def _gentler(before, here, after):  # type: ignore[no-untyped-def]
    """The smaller of the two differences, so that a step beside the pixel does not count as its slope."""
    return min(abs(here - before), abs(after - here))
