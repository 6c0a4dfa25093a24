"""Random fields that vary as smoothly as a matching window does: the noise of matches, and where matching fails."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simgen.compiled import compiled

FAILURE_BLUR = 2.5  # pixels; failures are where a field so smooth is lowest
# White noise plus two blurs of it, whose correlation is 0.63 / 0.44 / 0.32 / 0.17 at 1 / 2 / 3 / 5 pixels (DESIGN.md)
NOISE_BLURS = ((2.5, 1.0), (9.5, 3.1))  # weight, standard deviation in pixels

Image = NDArray[np.float32]


def matching_noise(shape: tuple[int, ...], rng: np.random.Generator, stretch: float = 1.0) -> Image:
    """Normal numbers (H, W) of variance 1, correlated as neighboring matching windows are.

    `stretch` multiplies the lengths over which they are; of each blur's share of the variance it changes nothing.
    """
    kernels = [(stretch * weight, _taps(max(stretch * deviation, 0.1))) for weight, deviation in NOISE_BLURS]
    margin = max(len(taps) // 2 for _, taps in kernels)
    square = np.zeros((2 * margin + 1,) * 2)
    square[margin, margin] = 1
    for weight, taps in kernels:
        inside = slice(margin - len(taps) // 2, margin + len(taps) // 2 + 1)
        square[inside, inside] += weight * np.outer(taps, taps)
    white = rng.standard_normal((shape[0] + 2 * margin, shape[1] + 2 * margin), np.float32)
    white *= np.float32(1 / np.sqrt((square * square).sum()))
    total = white[margin : margin + shape[0], margin : margin + shape[1]].copy()
    for weight, taps in kernels:
        _add_blurred(white, taps, margin, np.float32(weight), total)
    return total


def failure_field(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    """Numbers (H, W) of mean 0 and variance 1 that vary slowly, so that where they are low are blobs.

    Each is a weighted sum of hundreds of uniform numbers and so as good as normal.
    """
    taps = _taps(FAILURE_BLUR)
    margin = len(taps) // 2
    white = rng.random((shape[0] + 2 * margin, shape[1] + 2 * margin), np.float32)
    white -= np.float32(0.5)
    smooth = np.zeros(shape, np.float32)
    _add_blurred(white, taps, margin, np.float32(math.sqrt(12) / np.sum(taps.astype(float) ** 2)), smooth)
    return smooth


def _taps(deviation: float) -> NDArray[np.float32]:
    """A Gaussian window of odd length that sums to 1, to three standard deviations."""
    reach = math.ceil(3 * deviation)
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    return (window / window.sum()).astype(np.float32)


@compiled
def _add_blurred(field, taps, margin, weight, out):  # type: ignore[no-untyped-def]
    """Add to `out` (H, W) `weight` times `field` (H + 2 margin, W + 2 margin) convolved with `taps` both ways.

    Four taps at once: so compiled, it takes a seventh of the time of one after the other, and gives the same bits.
    """
    count, reach = len(taps), len(taps) // 2
    first, fours = margin - reach, count // 4 * 4
    along = np.zeros((out.shape[0] + 2 * reach, out.shape[1]), np.float32)
    for v in range(len(along)):
        line = field[first + v, first:]
        for k in range(0, fours, 4):
            _add_four(along[v], taps[k : k + 4], line[k:], line[k + 1 :], line[k + 2 :], line[k + 3 :])
        for k in range(fours, count):
            _add_one(along[v], taps[k], line[k:])
    taps = weight * taps
    for v in range(len(out)):
        for k in range(0, fours, 4):
            _add_four(out[v], taps[k : k + 4], along[v + k], along[v + k + 1], along[v + k + 2], along[v + k + 3])
        for k in range(fours, count):
            _add_one(out[v], taps[k], along[v + k])


@compiled
def _add_four(out, taps, a, b, c, d):  # type: ignore[no-untyped-def]
    ta, tb, tc, td = taps[0], taps[1], taps[2], taps[3]
    for u in range(len(out)):
        out[u] = out[u] + ta * a[u] + tb * b[u] + tc * c[u] + td * d[u]


@compiled
def _add_one(out, tap, line):  # type: ignore[no-untyped-def]
    for u in range(len(out)):
        out[u] += tap * line[u]
