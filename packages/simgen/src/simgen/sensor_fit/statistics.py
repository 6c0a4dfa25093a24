"""What depth images show of the camera's errors, each figure with the number of pixels that it rests on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from simgen.sensor_fit.seen_surface import STEP, Image, Mask, Surface, inverse_depth, slope_of, surface_of, surfaces_of

SLOPES = (0.0, 30.0, 45.0, 60.0, 75.0)  # degrees, of the groups of slope
LAGS = (1, 2, 3)  # pixels
BESIDE = 8  # pixels from a step
DISTANCES = 3  # groups of equally many pixels
NEAR_STEP = 4  # pixels within which flying ones are counted
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Statistics:
    """Figures of a set of depth images. Counts are of pixels; a figure of few of them is worth little.

    Attributes:
        noise, noise_count: (4,) standard deviation, in pixels of disparity for a baseline of one meter, of what a
            quadric fitted to 7 x 7 pixels leaves, by slope.
        noise_by_distance: (3,) the same of slopes below 45 degrees, the nearest third of the pixels first; and `depths`
            (3,) meters, their median distances.
        correlation: (3,) of that between pixels 1, 2, 3 apart.
        missing, missing_count: (4,) share without a return away from steps, by slope.
        beside, beside_count: (3, 8) share without a return 1 .. 8 pixels from a step in the row: behind it where the
            nearer surface lies on the right, where it lies on the left, and on the nearer surface.
        flying: share of the returns within four pixels of a step that belong to no surface.
        missing_all: share without a return of all pixels in sight.
        temporal: noise of a pixel of facing surface from image to image of one scene, in the unit of `noise`; NaN where
            the images show several scenes.
    """

    noise: Array
    noise_count: Array
    noise_by_distance: Array
    depths: Array
    correlation: Array
    missing: Array
    missing_count: Array
    beside: Array
    beside_count: Array
    flying: float
    missing_all: float
    temporal: float


def statistics_of(depths: Sequence[Image], camera: Camera, static: bool) -> Statistics:
    """Figures of depth images (H, W) in meters, 0 = no return; `static` ones show one scene."""
    surfaces = surfaces_of(depths, camera, static)
    parts = []
    for depth, surface in zip(depths, surfaces, strict=True):
        q = inverse_depth(depth, camera)
        parts.append(_Pixels.of(q, surface_of(q, camera.fx) if static else surface, surface, camera))
    residual, slope, z = (np.concatenate([getattr(p, name) for p in parts]) for name in ("residual", "slope", "z"))
    noise, noise_count = _by_slope(slope, residual, _spread)
    facing = slope < math.tan(math.radians(45.0))
    thirds = np.array_split(np.argsort(z[facing], kind="stable"), DISTANCES)
    missing, missing_count = _by_slope(
        np.concatenate([p.smooth_slope for p in parts]), np.concatenate([p.smooth_missing for p in parts]), _mean
    )
    lost, beside_count = (sum(getattr(p, name) for p in parts) for name in ("beside_lost", "beside_count"))
    returns, flying = (sum(getattr(p, name) for p in parts) for name in ("near_returns", "near_flying"))
    return Statistics(
        noise=noise,
        noise_count=noise_count,
        noise_by_distance=np.array([_spread(residual[facing][third]) for third in thirds]),
        depths=np.array([float(np.median(z[facing][third])) if len(third) else math.nan for third in thirds]),
        correlation=np.mean([p.correlation for p in parts], axis=0),
        missing=missing,
        missing_count=missing_count,
        beside=np.divide(lost, beside_count, out=np.full(np.shape(lost), np.nan), where=np.asarray(beside_count) > 0),
        beside_count=np.asarray(beside_count, float),
        flying=float(flying) / max(float(returns), 1.0),
        missing_all=float(sum(p.lost for p in parts)) / max(float(sum(p.counted for p in parts)), 1.0),
        temporal=_temporal(depths, camera) if static else math.nan,
    )


@dataclass(frozen=True, eq=False)
class _Pixels:
    """One image's share of the figures."""

    residual: Image
    slope: Image
    z: Image
    correlation: Array
    smooth_slope: Image
    smooth_missing: Image
    beside_lost: Array
    beside_count: Array
    near_returns: int
    near_flying: int
    lost: int
    counted: int

    @classmethod
    def of(cls, q: Image, own: Surface, true: Surface, camera: Camera) -> _Pixels:
        valid, counted = q > 0, true.counted
        slope = slope_of(true.q, camera.fx, camera.fy)
        beside, near = _steps(true.q, camera.fx)
        smooth = counted & ~near
        used = smooth & own.full & (slope < math.tan(math.radians(SLOPES[-1])))
        residual = np.where(used, q - own.q, 0).astype(np.float32)
        lost = np.array([[(counted & side & ~valid).sum() for side in sides] for sides in beside], float)
        count = np.array([[(counted & side).sum() for side in sides] for sides in beside], float)
        close = counted & near & valid
        return cls(
            residual=residual[used],
            slope=slope[used],
            z=camera.fx / true.q[used],
            correlation=_correlation(residual, used),
            smooth_slope=slope[smooth],
            smooth_missing=(~valid[smooth]).astype(np.float32),
            beside_lost=lost,
            beside_count=count,
            near_returns=int(close.sum()),
            near_flying=int((close & own.flying).sum()),
            lost=int((counted & ~valid).sum()),
            counted=int(counted.sum()),
        )


def _steps(q: Image, fx: float) -> tuple[list[list[Mask]], Mask]:
    """Pixels at 1 .. 8 from a step in the row, on its three sides; and all within four pixels of any step."""
    jump = np.zeros_like(q)
    jump[:, 1:] = (q[:, 1:] - q[:, :-1]) * fx / np.minimum(q[:, 1:], q[:, :-1])  # at the right one of both pixels
    rise, fall = jump > STEP, jump < -STEP  # nearer on the right, on the left
    down = np.zeros_like(rise)
    down[1:] = np.abs(q[1:] - q[:-1]) * fx / np.minimum(q[1:], q[:-1]) > STEP
    any_step = rise | fall | down
    before: list[Mask] = []
    after: list[Mask] = []
    nearer: list[Mask] = []
    seen = np.zeros_like(rise)
    for distance in range(1, BESIDE + 1):
        on_left, on_right = _moved(rise, -distance), _moved(fall, distance - 1)
        on_near = _moved(rise, distance - 1) | _moved(fall, -distance)
        for group, found in ((before, on_left), (after, on_right), (nearer, on_near)):
            group.append(found & ~seen)
        seen |= on_left | on_right | on_near
    near = np.zeros_like(rise)
    for rows in range(-NEAR_STEP, NEAR_STEP):
        near |= np.roll(any_step, rows, 0)
    near = near | np.any([_moved(near, columns) for columns in range(-NEAR_STEP, NEAR_STEP)], axis=0)
    return [before, after, nearer], near


def _moved(mask: Mask, columns: int) -> Mask:
    """The mask moved to the right; nothing comes in from beyond the image."""
    out = np.zeros_like(mask)
    if columns >= 0:
        out[:, columns:] = mask[:, : mask.shape[1] - columns]
    else:
        out[:, :columns] = mask[:, -columns:]
    return out


def _by_slope(slope: Image, values: Image, figure: Callable[[Image], float]) -> tuple[Array, Array]:
    edges = np.tan(np.radians(SLOPES))
    groups = [values[(slope >= low) & (slope < high)] for low, high in pairwise(edges)]
    return np.array([figure(group) for group in groups]), np.array([float(len(group)) for group in groups])


def _spread(values: NDArray[np.floating]) -> float:
    """Standard deviation of what is normal with some outliers: half of where the middle 68 % lie."""
    if len(values) < 30:
        return math.nan
    low, high = np.percentile(values, [15.866, 84.134])
    return float(high - low) / 2


def _mean(values: Image) -> float:
    return float(values.mean()) if len(values) else math.nan


def _correlation(residual: Image, used: Mask) -> Array:
    limit = 4 * _spread(residual[used]) if used.sum() >= 30 else 0.0
    kept = used & (np.abs(residual) < limit)
    found = []
    for lag in LAGS:
        pairs = [
            (residual[:, lag:], residual[:, :-lag], kept[:, lag:] & kept[:, :-lag]),
            (residual[lag:], residual[:-lag], kept[lag:] & kept[:-lag]),
        ]
        products = np.concatenate([(a * b)[both] for a, b, both in pairs])
        found.append(float(products.mean() / max(float(residual[kept].var()), 1e-12)) if len(products) else 0.0)
    return np.array(found)


def _temporal(frames: Sequence[Image], camera: Camera) -> float:
    """Spread of a pixel's inverse depth from image to image where all have returned."""
    every = np.stack([inverse_depth(depth, camera) for depth in frames])
    seen = (every > 0).all(0)
    return _spread((every[:, seen] - np.median(every[:, seen], axis=0)).ravel())
