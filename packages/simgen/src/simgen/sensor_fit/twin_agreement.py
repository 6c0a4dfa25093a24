"""Figure by figure, whether the fitted sensor's images show what the camera's do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from simgen.sensor_fit.statistics import LAGS, SLOPES, Statistics

ENOUGH = 300  # pixels; figures of fewer are shown, not judged
NOISE_SHARE, NOISE_FLOOR = 0.25, 0.05  # of the figure, and millimeters
MISSING_SHARE, MISSING_FLOOR, MISSING_MOST = 0.25, 0.03, 0.15
BESIDE_FLOOR = 0.12
CORRELATION_FLOOR = 0.12


@dataclass(frozen=True)
class Row:
    """One figure: of the camera's images, of the twin's, and how far apart they may be. `pixels` it rests on.

    `heap` is that of simulated heaps of the part, where one was given; what lies in them differs from what the camera
    saw, so that it is shown and not judged.
    """

    name: str
    real: float
    twin: float
    tolerance: float
    pixels: float
    unit: str = ""
    heap: float = math.nan

    @property
    def judged(self) -> bool:
        return self.pixels >= ENOUGH and math.isfinite(self.real) and math.isfinite(self.twin)

    @property
    def agrees(self) -> bool:
        return not self.judged or abs(self.real - self.twin) <= self.tolerance


def rows(real: Statistics, twin: Statistics, fx: float, heap: Statistics | None = None) -> Iterator[Row]:
    """All figures; noise as millimeters at the distance where it was seen. `fx` in pixels."""
    if heap is None:
        yield from _rows(real, twin, fx)
        return
    for row, other in zip(_rows(real, twin, fx), _rows(real, heap, fx), strict=True):
        yield replace(row, heap=other.twin)


def _rows(real: Statistics, twin: Statistics, fx: float) -> Iterator[Row]:
    middle = float(real.depths[1])
    scale = 1e3 * middle**2 / fx
    groups = [f"{low:g} to {high:g}°" for low, high in pairwise(SLOPES)]
    for i, words in enumerate(groups):
        yield _noise(f"noise on slopes of {words}", real.noise[i], twin.noise[i], scale, real.noise_count[i])
    for i, z in enumerate(real.depths):
        count = float(real.noise_count[:2].sum()) / 3
        yield _noise(
            f"noise at {z:.3g} m", real.noise_by_distance[i], twin.noise_by_distance[i], 1e3 * z**2 / fx, count
        )
    if math.isfinite(real.temporal):
        yield _noise("noise from image to image", real.temporal, twin.temporal, scale, real.noise_count.sum())
    for i, lag in enumerate(LAGS):
        name = f"correlation at {lag} pixel{'s' * (lag > 1)}"
        yield Row(name, real.correlation[i], twin.correlation[i], CORRELATION_FLOOR, real.noise_count.sum())
    yield _share("missing in all", real.missing_all, twin.missing_all, MISSING_FLOOR, real.missing_count.sum())
    for i, words in enumerate(groups):
        yield _share(
            f"missing on slopes of {words}", real.missing[i], twin.missing[i], MISSING_FLOOR, real.missing_count[i]
        )
    sides = ("behind a step, nearer on the right", "behind a step, nearer on the left", "on the nearer side of a step")
    for side, words in enumerate(sides):
        for low, high in ((0, 2), (2, 5), (5, 8)):
            part = slice(low, high)
            missing = [(s.beside[side, part] * s.beside_count[side, part]).sum() for s in (real, twin)]
            totals = [max(s.beside_count[side, part].sum(), 1.0) for s in (real, twin)]
            name = f"missing {low + 1} to {high} pixels {words}"
            pixels = real.beside_count[side, part].sum()
            yield _share(name, missing[0] / totals[0], missing[1] / totals[1], BESIDE_FLOOR, pixels)
    yield _share("flying pixels beside steps", real.flying, twin.flying, 0.02, real.beside_count.sum())


def _noise(name: str, real: float, twin: float, scale: float, pixels: float) -> Row:
    real, twin = float(real) * scale, float(twin) * scale
    return Row(name, real, twin, max(NOISE_SHARE * real, NOISE_FLOOR), float(pixels), "mm")


def _share(name: str, real: float, twin: float, floor: float, pixels: float) -> Row:
    real, twin = float(real), float(twin)
    tolerance = max(min(MISSING_SHARE * real, MISSING_MOST), floor)
    return Row(name, 100 * real, 100 * twin, 100 * tolerance, float(pixels), "%")
