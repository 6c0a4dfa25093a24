"""The ICVL Bin-Picking dataset's files (Doumanoglou et al. 2016): 4x4 text matrices, metres, OpenGL axes."""

from __future__ import annotations

from pathlib import Path

from evalkit.documents import GroundTruth
from evalkit.errors import InputError


def read_ground_truth(folder: Path, *, mesh: Path | None = None, visibility: Path | None = None) -> GroundTruth:
    """Read ``test/NN``: camera_pose_I.txt and the poses of one object's instances."""
    raise InputError(f"{folder}: the ICVL adapter is being written.")
