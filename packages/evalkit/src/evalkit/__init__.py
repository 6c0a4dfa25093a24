"""Poses, cameras, symmetry, datasets on disk, and how good a prediction is.

What is listed in `__all__` is imported when it is first asked for: a reader of shards needs no scoring.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evalkit.datasets.documents import (
        GroundTruth,
        GroundTruthImage,
        PredictionImage,
        Predictions,
        read_ground_truth,
        read_predictions,
        write_ground_truth,
        write_predictions,
    )
    from evalkit.errors import InputError
    from evalkit.scoring.evaluation import average_precision
    from evalkit.scoring.result import Result

__all__ = [
    "GroundTruth",
    "GroundTruthImage",
    "InputError",
    "PredictionImage",
    "Predictions",
    "Result",
    "average_precision",
    "read_ground_truth",
    "read_predictions",
    "write_ground_truth",
    "write_predictions",
]
_ELSEWHERE = {
    "InputError": "evalkit.errors",
    "Result": "evalkit.scoring.result",
    "average_precision": "evalkit.scoring.evaluation",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'evalkit' has no attribute '{name}'")
    return getattr(import_module(_ELSEWHERE.get(name, "evalkit.datasets.documents")), name)
