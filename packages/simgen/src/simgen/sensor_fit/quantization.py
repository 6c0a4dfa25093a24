"""The steps in which depth comes, of the depth itself or of the disparity behind it: combs, found by their period."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

CLEAR = 0.5  # length of the mean phasor from which on values lie on a comb; 0 without one, 1 for a perfect one
SAMPLE = 4_000  # values looked at
FINEST = 1500  # steps in the range of the values, of the finest comb that is searched for
DISTINCT = 12  # values; fewer lie on many combs
DEPTH_STEPS = tuple(m * 10.0**e for e in (-4, -3, -2) for m in (1.0, 1.25, 2.0, 2.5, 5.0))  # meters

Array = NDArray[np.float64]


def depth_step(values: Array) -> float:
    """The largest usual step of depth, in meters, of which all `values` (n,) are multiples; 0 where there is none."""
    values = _sample(values)
    if len(np.unique(values)) < DISTINCT:
        return 0.0
    fitting = [step for step in DEPTH_STEPS if _on_comb(values, step) > 0.95]
    return max(fitting, default=0.0)


def inverse_step(q: Array, depth_unit: float, fx: float) -> float:
    """Step of the inverse depth q (n,), in its own unit; 0 where no comb is seen.

    Args:
        depth_unit: meters, step of the depth that q was computed of: a comb finer than that cannot be seen.
    """
    q = np.sort(_sample(q))
    finest = 2.5 * depth_unit * float(np.percentile(q, 10)) ** 2 / fx  # where depth is coarsest in q
    q = q[: max(len(q) // 2, 1)]  # the far half, where depth resolves q best
    span = float(q[-1] - q[0])
    finest = max(2.5 * depth_unit * float(np.median(q)) ** 2 / fx, finest, span / FINEST)
    if span <= 4 * finest or len(np.unique(q)) < DISTINCT:
        return 0.0
    frequencies = np.arange(2.0, span / finest) / span
    frequencies = np.concatenate([frequencies + offset / span for offset in (0, 1 / 3, 2 / 3)])
    strength = np.array([_on_comb(q, 1 / frequency) for frequency in frequencies])
    clear = frequencies[strength > CLEAR]
    if len(clear) == 0:
        return 0.0
    lowest = clear.min()  # the others are its multiples
    near = np.linspace(lowest - 1.0 / span, lowest + 1.0 / span, 161)
    return float(1 / near[np.argmax([_on_comb(q, 1 / frequency) for frequency in near])])


def _on_comb(values: Array, step: float) -> float:
    """How well values lie on multiples of `step` plus any offset: length of their mean phasor."""
    return float(np.abs(np.exp(2j * np.pi * (values / step)).mean()))


def _sample(values: Array | Sequence[float]) -> Array:
    values = np.asarray(values, float)
    return values[:: max(len(values) // SAMPLE, 1)]
