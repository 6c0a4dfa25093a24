"""What a depth camera might have made of an image, drawn anew each time the image trains.

Not a model of one camera (that is simgen's `--sensor`, and belongs into the shards) but of what cameras differ in, from
none of it to more than a bad stereo camera does: how strong the noise is, how far it reaches across pixels and how it
grows with depth and slope; steps of disparity; which side of an edge has no return, and how far from it; holes on
smooth surface; patches and single pixels at the depth of something beside them. A network that saw all of it reads the
images of a camera that nobody modeled; poses stay as they are.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

CLEAN = 0.25  # share of the images that stay as they are
OCTAVES = 4  # noise at every pixel, every second, every fourth, every eighth
HOLE_CELL = 5.0  # pixels across a hole, about
EDGE_STEPS = (0.04, 0.15)  # diameters between neighboring pixels that make an edge
EDGE_REACH = (1.0, 5.0)  # pixels: what is lost beside edges falls by e in so many
EDGE_LOSS = 0.8  # largest share lost right beside an edge
SHADOW_LOSS = 1.0  # largest share lost of what the second eye does not see
LONGEST_BASELINE = 1.0  # diameters between the two eyes
PATCHES = 0.4  # largest area of wrong patches, over the area close to edges
PATCH_RADII = (1.0, 4.0)  # pixels
PATCH_JUMP = 4.0  # pixels beyond its own rim from which a wrong patch may have its depth
FLYING = 0.3  # largest share of the pixels at an edge that lie between its two sides
SLOPE_GROWTH = 0.6  # largest growth of the noise with the tangent of the slope
STEEPEST = (70.0, 90.0)  # degrees from where on a surface does not return
FARTHEST = 200  # pixels to an edge; farther ones are not told apart

Image = NDArray[np.float32]
_compiled = numba.njit(cache=True, nogil=True, error_model="numpy")


class Degradation(NamedTuple):
    """Upper bounds; each image draws its own values below them."""

    noise: float  # standard deviation of depth, and step of it, in diameters at the image's median depth
    holes: float  # share of pixels without return on smooth surface

    def times(self, factor: float) -> Degradation:
        return Degradation(self.noise * factor, self.holes * factor)


def generator_of(seed: int, step: int, image: int) -> np.random.Generator:
    """The randomness of one image of one training step: a resumed run degrades as an unbroken one does."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3, step, image)))


def degrade(depth: Image, bounds: Degradation, diameter: float, focal: float, rng: np.random.Generator) -> Image:
    """One image (H, W) in meters, 0 = no return, as some other camera might have measured it.

    Args:
        diameter: of the object, meters. focal: focal length, pixels.
    """
    seen = depth[::4, ::4]
    seen = seen[seen > 0]
    if rng.random() < CLEAN or not any(bounds) or len(seen) == 0:
        return depth
    typical, strength = float(np.median(seen)), rng.random()
    share = strength * rng.uniform(0.3, 1.0, 6)  # of each error's bound
    edge = _edge_distance(depth, np.float32(rng.uniform(*EDGE_STEPS) * diameter))
    wrong = _displaced(depth, edge, share[0] * PATCHES, share[1] * FLYING, rng)
    eye = rng.choice((-1.0, 1.0)) * rng.uniform(0, LONGEST_BASELINE) * diameter * focal
    hidden = _hidden_from(depth, np.float32(eye))
    limits = _loss_limits(share[2] * bounds.holes, share[3] * EDGE_LOSS, rng.uniform(*EDGE_REACH))
    field, noise = _field(depth.shape, HOLE_CELL, rng), _correlated_noise(depth.shape, rng)
    sigma, quantum = strength * bounds.noise * diameter, rng.integers(2) * share[4] * bounds.noise * diameter
    return _measured(
        depth, wrong, edge, hidden, field, noise, limits, np.float32(_upper(rng.random() * SHADOW_LOSS)),
        np.array([sigma * rng.uniform(0.3, 1.0), share[5] * SLOPE_GROWTH, quantum, typical, focal,
                  math.tan(math.radians(rng.uniform(*STEEPEST) - 0.1))], np.float32),
    )  # fmt: skip


def _loss_limits(smooth: float, edge: float, reach: float) -> Image:
    """Values of a standard normal field above which the return is lost, at each distance to an edge 0 .. FARTHEST."""
    distance = np.arange(1, 13)
    beside = 1 - (1 - smooth) * (1 - edge * np.exp(-(distance - 1) / reach))
    limits = np.full(FARTHEST + 1, _upper(smooth), np.float32)
    limits[1:13] = [_upper(share) for share in beside]
    limits[0] = limits[1]
    return limits


def _upper(share: float) -> float:
    """Above which a standard normal number lies with this probability."""
    if share <= 0:
        return math.inf
    return NormalDist().inv_cdf(1 - share) if share < 1 else -math.inf


def _field(shape: tuple[int, ...], cell: float, rng: np.random.Generator) -> Image:
    """Smooth noise (H, W) of variance 1 whose correlation reaches `cell` pixels."""
    height, width = shape
    coarse = rng.standard_normal((int(height / cell) + 3, int(width / cell) + 3), np.float32)
    out = np.zeros(shape, np.float32)
    _add_enlarged(coarse, np.float32(cell), np.float32(1), out)
    return out / max(float(out.std()), 1e-6)


def _correlated_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    """Octaves in proportions drawn for this image, together of variance 1."""
    height, width = shape
    first, *others = rng.random(OCTAVES, np.float32)
    out = first * rng.standard_normal(shape, np.float32)
    for octave, weight in enumerate(others, 1):
        cell = 2**octave
        coarse = rng.standard_normal((height // cell + 3, width // cell + 3), np.float32)
        _add_enlarged(coarse, np.float32(cell), weight, out)
    return out / max(float(out.std()), 1e-6)


def _displaced(depth: Image, edge: NDArray[np.uint8], patches: float, flying: float, rng: np.random.Generator) -> Image:
    """The image with patches, and single pixels at edges, at the depth of something beside them."""
    out = depth.copy()
    close = np.flatnonzero((edge <= 3) & (depth > 0))
    mean_area = math.pi * (sum(PATCH_RADII) / 2) ** 2
    middles = close[rng.integers(0, max(len(close), 1), rng.poisson(patches * len(close) / mean_area))]
    radii = rng.uniform(*PATCH_RADII, (len(middles), 2))
    angle, jump = rng.uniform(0, 2 * math.pi, len(middles)), rng.uniform(0, PATCH_JUMP, len(middles))
    reach = radii.max(1, initial=0.0) + jump
    away = np.rint(np.stack([reach * np.cos(angle), reach * np.sin(angle)], 1)).astype(np.int64)
    _put_patches(depth, middles, radii, away, out)
    beside = close[(edge.ravel()[close] <= 1)]
    beside = beside[rng.random(len(beside)) < flying]
    _let_fly(depth, beside, rng.random(len(beside), np.float32), out)
    return out


@_compiled
def _add_enlarged(coarse, cell, weight, out):  # type: ignore[no-untyped-def]
    """Add to `out` (H, W) `weight` times the coarse grid, one value every `cell` pixels, linear between them."""
    height, width = out.shape
    for v in range(height):
        y = v / cell
        row = int(y)
        b = np.float32(y - row)
        for u in range(width):
            x = u / cell
            column = int(x)
            a = np.float32(x - column)
            above = coarse[row, column] * (1 - a) + coarse[row, column + 1] * a
            below = coarse[row + 1, column] * (1 - a) + coarse[row + 1, column + 1] * a
            out[v, u] += weight * (above * (1 - b) + below * b)


@_compiled
def _edge_distance(depth, step):  # type: ignore[no-untyped-def]
    """Pixels (H, W) along rows and columns to the other side of the nearest edge, at most FARTHEST."""
    height, width = depth.shape
    out = np.full((height, width), FARTHEST, np.uint8)
    for v in range(height):
        for u in range(width):
            here = depth[v, u]
            if u + 1 < width and here > 0 and depth[v, u + 1] > 0 and abs(depth[v, u + 1] - here) > step:
                out[v, u] = out[v, u + 1] = 1
            if v + 1 < height and here > 0 and depth[v + 1, u] > 0 and abs(depth[v + 1, u] - here) > step:
                out[v, u] = out[v + 1, u] = 1
    one = np.uint8(1)
    for v in range(height):
        for u in range(width):
            least = out[v, u]
            if u > 0:
                least = min(least, out[v, u - 1] + one)
            if v > 0:
                least = min(least, out[v - 1, u] + one)
            out[v, u] = min(least, np.uint8(FARTHEST))
    for v in range(height - 1, -1, -1):
        for u in range(width - 1, -1, -1):
            least = out[v, u]
            if u + 1 < width:
                least = min(least, out[v, u + 1] + one)
            if v + 1 < height:
                least = min(least, out[v + 1, u] + one)
            out[v, u] = min(least, np.uint8(FARTHEST))
    return out


@_compiled
def _hidden_from(depth, eye):  # type: ignore[no-untyped-def]
    """Where a second eye (`eye` = focal times its place along x, meters times pixels) sees something nearer (H, W)."""
    height, width = depth.shape
    out = np.zeros((height, width), np.bool_)
    side = np.float32(1.0) if eye > 0 else np.float32(-1.0)
    for v in range(height):
        extreme = np.float32(1e9)
        for k in range(width):
            u = width - 1 - k if eye > 0 else k
            if depth[v, u] > 0:
                column = side * (np.float32(u) - eye / depth[v, u])
                out[v, u] = column >= extreme
                extreme = min(extreme, column)
    return out


@_compiled  # as simgen.sensors.sensor has it: neither package imports the other, and evalkit compiles nothing
def _put_patches(depth, middles, radii, away, out):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for i in range(len(middles)):
        v0, u0 = middles[i] // width, middles[i] % width
        v, u = v0 + away[i, 1], u0 + away[i, 0]
        if not (0 <= u < width and 0 <= v < height) or depth[v, u] == 0:
            continue
        value, a, b = depth[v, u], radii[i, 0], radii[i, 1]
        for y in range(max(0, int(v0 - b)), min(height, int(v0 + b) + 1)):
            for x in range(max(0, int(u0 - a)), min(width, int(u0 + a) + 1)):
                if ((x - u0) / a) ** 2 + ((y - v0) / b) ** 2 <= 1:
                    out[y, x] = value


@_compiled
def _let_fly(depth, pixels, share, out):  # type: ignore[no-untyped-def]
    """Give pixels a depth between their own and that of the neighbor that differs most."""
    height, width = depth.shape
    for i in range(len(pixels)):
        v, u = pixels[i] // width, pixels[i] % width
        here = depth[v, u]
        most = np.float32(0.0)
        for dv, du in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            y, x = v + dv, u + du
            if 0 <= y < height and 0 <= x < width and depth[y, x] > 0 and abs(depth[y, x] - here) > abs(most):
                most = depth[y, x] - here
        out[v, u] = here + share[i] * most


@_compiled
def _measured(depth, wrong, edge, hidden, field, noise, limits, shadow, amounts):  # type: ignore[no-untyped-def]
    """Noise, steps of disparity, and what is lost."""
    height, width = depth.shape
    sigma, per_slope, quantum, typical, focal, steepest = amounts
    out = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            here = depth[v, u]
            if here == 0:
                continue
            limit = limits[edge[v, u]]
            if field[v, u] > (min(limit, shadow) if hidden[v, u] else limit):
                continue
            across, down = np.float32(0.0), np.float32(0.0)
            if 0 < u < width - 1:
                across = min(abs(depth[v, u + 1] - here), abs(depth[v, u - 1] - here))
            if 0 < v < height - 1:
                down = min(abs(depth[v + 1, u] - here), abs(depth[v - 1, u] - here))
            slope = focal * math.sqrt(across * across + down * down) / here
            if slope > steepest:
                continue
            z = wrong[v, u]
            grown = (z / typical) ** 2
            z += sigma * (1 + per_slope * min(slope, np.float32(4.0))) * grown * noise[v, u]
            if quantum > 0 and z > 0:
                step = quantum / (typical * typical)
                z = 1 / (max(math.floor(1 / (z * step) + 0.5), 1.0) * step)
            out[v, u] = max(z, np.float32(1e-3))
    return out
