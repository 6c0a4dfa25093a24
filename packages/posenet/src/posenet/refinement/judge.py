"""How likely a refined pose is right: two logistic regressions, the same for every part and camera.

The first hears what the image says of a pose alone, the second also its better neighbors. Their few numbers lie beside
this file in judge.json, made by benchmarks/judge.py on simulated piles; each input has a center, a scale and a weight,
so that what moves a score can be read off the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.json_file import load_json
from evalkit.typed import typed

Array = NDArray[np.float64]
FORMAT = "binpose-judge/1"
FARTHEST = 3.0  # scales from its center that an input counts: what is farther off was not in the data


@dataclass(frozen=True)
class Regression:
    """Log-odds from named inputs."""

    bias: float
    terms: dict[str, tuple[float, float, float]]  # of each input the center, the scale, and the weight in scales

    def logit(self, inputs: Mapping[str, Array]) -> Array:
        """Log-odds (n,) from columns (n,), which may be more than it has terms for."""
        total: Array = np.full(len(next(iter(inputs.values()))), self.bias)
        for name, (center, scale, weight) in self.terms.items():
            total += weight * np.clip((inputs[name] - center) / scale, -FARTHEST, FARTHEST)
        return total


@dataclass(frozen=True)
class Judge:
    """`alone` hears :mod:`posenet.refinement.pose_evidence`, `among` hears :mod:`posenet.refinement.neighbors`."""

    format: str
    alone: Regression
    among: Regression

    @classmethod
    def read(cls, path: Path | str) -> Judge:
        """From a file that benchmarks/judge.py wrote.

        Raises:
            InputError: it is none, or lacks something.
        """
        document = load_json(path)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise InputError(f"{path}: the field 'format' is not {FORMAT!r}; write one with benchmarks/judge.py.")
        return typed(cls, document, str(path))


@cache
def shipped_judge() -> Judge:
    """The one that comes along, for all parts."""
    return Judge.read(Path(__file__).with_name("judge.json"))


def probability(logit: Array) -> Array:
    """Log-odds (n,) as probabilities (n,)."""
    return np.asarray(1.0 / (1.0 + np.exp(-logit)))
