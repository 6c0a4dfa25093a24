"""How much of a score, or of the difference of two, is chance: the bootstrap over scenes (Efron 1979).

Views of one scene show the same instances, so scenes are drawn, with replacement, and all views of a drawn scene count.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.scoring.result import Result

Array = NDArray[np.float64]
LEVEL = 0.95
OUR_IMAGE_ID = re.compile(r"(\d{6})-\d+")  # scene and view, as View.image_id has them


@dataclass(frozen=True)
class Interval:
    """A percentile interval of level 0.95 about a figure."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4f} [{self.low:.4f}, {self.high:.4f}]"


@dataclass(frozen=True)
class Comparison:
    """Two methods on the same images. `better` is the share of resamples in which the second one's AP is higher."""

    first: Interval
    second: Interval
    difference: Interval
    better: float
    resamples: int

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "level": LEVEL}


def intervals(result: Result, resamples: int, seed: int = 0) -> dict[str, Interval]:
    """Intervals of AP, MAP and best F1.

    Raises:
        InputError: `resamples` is not positive.
    """
    drawn = []
    known = ~np.isnan(result.image_ap)
    for weights in _weights(result, resamples, seed):
        curve = result.steps.curve(weights)
        counted = weights * known
        mean = (counted * np.where(known, result.image_ap, 0.0)).sum() / max(counted.sum(), 1.0)
        drawn.append((result.area(curve), mean, curve.f1.max()))
    columns = np.array(drawn).T
    values = (result.ap, result.map, result.best_f1)
    return {key: _interval(v, c) for key, v, c in zip(("ap", "map", "best_f1"), values, columns, strict=True)}


def compare(first: Result, second: Result, resamples: int, seed: int = 0) -> Comparison:
    """The difference of AP, second less first, on the same resampled scenes.

    Raises:
        InputError: the two were not evaluated on the same images by the same rules.
    """
    if first.image_ids != second.image_ids or first.settings != second.settings:
        raise InputError(
            "the two results must be of the same images by the same rules; use --protocol sileane or coco."
        )
    weights = list(_weights(first, resamples, seed))
    a, b = (np.array([r.area(r.steps.curve(w)) for w in weights]) for r in (first, second))
    return Comparison(
        first=_interval(first.ap, a),
        second=_interval(second.ap, b),
        difference=_interval(second.ap - first.ap, b - a),
        better=float((b > a).mean()),
        resamples=resamples,
    )


def scene_numbers(image_ids: list[str]) -> NDArray[np.int64]:
    """Which images belong to one scene: ids such as 000012-003 share 000012; any other image is its own scene."""
    matches = [OUR_IMAGE_ID.fullmatch(name) for name in image_ids]
    names = [name if match is None else match[1] for name, match in zip(image_ids, matches, strict=True)]
    return np.asarray(np.unique(names, return_inverse=True)[1], np.int64)


def _weights(result: Result, resamples: int, seed: int) -> Iterator[Array]:
    """How often each image counts, resample by resample (S,)."""
    if resamples < 1:
        raise InputError(f"bootstrap {resamples} must be 1 or more resamples; 1000 is usual.")
    scene = scene_numbers(result.image_ids)
    count = int(scene.max()) + 1
    rng = np.random.default_rng(seed)
    for _ in range(resamples):
        yield rng.multinomial(count, np.full(count, 1.0 / count))[scene].astype(float)


def _interval(value: float, drawn: Array) -> Interval:
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(float(value), float(low), float(high))
