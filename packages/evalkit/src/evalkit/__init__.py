"""Poses, cameras, symmetry, datasets on disk, and how good a prediction is."""

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
from evalkit.scoring.evaluation import Result, average_precision

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
