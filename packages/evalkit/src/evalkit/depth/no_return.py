"""Values of depth images that mean "no return", besides 0, NaN, infinity and negative ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SPOTS = 16  # pixels; a value in fewer may be a stray measurement
LEAST_SHARE = 0.005  # of the pixels, from which on a lone value that is no known code is worth a remark
FAR = 2.0  # times the highest other value, from where on a code lies apart from what was measured
HIGHEST_16 = 65535
FULL_SCALES = tuple(2**bits - 1 for bits in range(11, 33))  # of sensors with so many bits
HALF_FLOAT = 65504.0  # the highest number that EXR's half floats hold
INFINITE = 1e9  # renderers write their background as 1e10 or as the highest float
DISTINCT = 8  # values; fewer are whole steps of something by chance
STEP_TOLERANCE = 2e-2  # of a step, by which float32 misses whole steps of a 16-bit image


def without_code(values: NDArray[Any], no_return: float | None = None) -> tuple[NDArray[Any], float | None]:
    """Values (height, width) as stored, those that mean "no return" as 0, and the code that they had, None if none.

    Args:
        no_return: the code as the user states it; without it, one is recognized: an integer type's highest value, and
            the highest value of sensors with fewer bits where it is frequent and far from everything measured.
    """
    if no_return is not None:
        hit = np.isclose(values, no_return, rtol=1e-6, atol=0.0)
        return _emptied(values, hit), no_return if hit.any() else None
    code = _integer_code(values) if values.dtype.kind in "ui" else _float_code(values)
    if code is None:
        return values, None
    return _emptied(values, values >= code), code


def lone_value(values: NDArray[Any]) -> float | None:
    """The highest value, where it is frequent and far beyond all others: a sensor's code, or a flat ground.

    What :func:`without_code` did not recognize; the image alone does not tell which it is.
    """
    measured = values[np.isfinite(values) & (values > 0)]
    highest = measured.max(initial=0)
    frequent = measured.size > 0 and (measured == highest).sum() >= LEAST_SHARE * values.size
    return float(highest) if frequent and _stands_apart(measured, highest) and (measured < highest).any() else None


def _emptied(values: NDArray[Any], where: NDArray[np.bool_]) -> NDArray[Any]:
    return np.where(where, np.zeros((), values.dtype), values)


def _integer_code(values: NDArray[Any]) -> float | None:
    highest = int(values.max(initial=0))
    if highest == np.iinfo(values.dtype).max:
        return float(highest)  # saturated: whatever it was, it was not measured
    return float(highest) if highest in FULL_SCALES and _stands_apart(values, highest) else None


def _float_code(values: NDArray[Any]) -> float | None:
    measured = values[np.isfinite(values) & (values > 0)]
    highest = float(measured.max(initial=0.0))
    if highest >= INFINITE:
        return INFINITE
    if highest == 0 or not _stands_apart(measured, measured.max()):
        return None
    known = highest in (HALF_FLOAT, *map(float, FULL_SCALES))
    return float(highest) if known or _is_scaled_16_bit(measured, highest) else None


def _stands_apart(values: NDArray[Any], highest: Any) -> bool:
    others = values[values < highest]
    return int((values == highest).sum()) >= SPOTS and FAR * float(others.max(initial=0)) < float(highest)


def _is_scaled_16_bit(measured: NDArray[Any], highest: float) -> bool:
    """Whether the values are whole steps of a 16-bit image whose highest value became `highest`."""
    others = np.unique(measured[measured < highest]).astype(np.float64) * (HIGHEST_16 / highest)
    return len(others) >= DISTINCT and bool((np.abs(others - np.round(others)) < STEP_TOLERANCE).all())
