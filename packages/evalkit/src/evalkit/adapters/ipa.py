"""The Fraunhofer IPA Bin-Picking dataset's files (Kleeberger et al. 2019): parameter.json and a CSV per image."""

from __future__ import annotations

from pathlib import Path

from evalkit.documents import GroundTruth
from evalkit.errors import InputError


def read_ground_truth(folder: Path, *, mesh: Path | None = None) -> GroundTruth:
    """Read the CSV files of an object's images: id, t, R column-major, visibility."""
    raise InputError(f"{folder}: the IPA adapter is being written.")
