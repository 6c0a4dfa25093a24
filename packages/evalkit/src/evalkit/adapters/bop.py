"""The BOP benchmark's datasets and result files (Hodaň et al. 2018): millimetres in, metres out, and back."""

from __future__ import annotations

from pathlib import Path

from evalkit.documents import GroundTruth, Predictions
from evalkit.errors import InputError


def read_ground_truth(folder: Path, *, object_id: int | None = None) -> GroundTruth:
    """Read a split (DATASET/test) or one of its scenes: every instance of one object."""
    raise InputError(f"{folder}: the BOP adapter is being written.")


def read_predictions(csv: Path, *, object_id: int | None = None) -> Predictions:
    """Read a results CSV ``scene_id,im_id,obj_id,score,R,t,time``."""
    raise InputError(f"{csv}: the BOP adapter is being written.")


def write_predictions(path: Path, predictions: Predictions, *, object_id: int | None = None) -> None:
    """Write a results CSV ``scene_id,im_id,obj_id,score,R,t,time``."""
    raise InputError(f"{path}: the BOP adapter is being written.")
