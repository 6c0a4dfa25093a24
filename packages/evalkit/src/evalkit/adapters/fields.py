"""Numbers and poses out of other people's documents, checked; every refusal names its place."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.datasets.pose_rows import FARTHEST, ROTATION_TOLERANCE
from evalkit.errors import InputError
from evalkit.geometry import poses

Array = NDArray[np.float64]


def numbers(document: Any, key: str, shape: tuple[int, ...], where: str) -> Array:
    """The field `key` as an array of `shape`, however its numbers are nested.

    Raises:
        InputError: the field is missing, or does not hold so many finite numbers.
    """
    try:
        array = np.array(document[key], dtype=float).reshape(shape)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: the field '{key}' is missing or does not hold numbers of shape {shape}.") from None
    if not np.isfinite(array).all():
        raise InputError(f"{where}: the field '{key}' holds a number that is not finite.")
    return array


def checked_poses(rotation: ArrayLike, translation: ArrayLike, place: Callable[[int], str]) -> Array:
    """Rotations (n, 3, 3) and translations (n, 3) in meters to poses (n, 4, 4); `place` names a row in messages.

    Raises:
        InputError: a number is not finite, a matrix is no rotation, or an object is farther than any bin.
    """
    rotation = np.asarray(rotation, float).reshape(-1, 3, 3)
    translation = np.asarray(translation, float).reshape(-1, 3)
    laws = [
        (np.isfinite(rotation).all((1, 2)) & np.isfinite(translation).all(1), "holds a number that is not finite"),
        (poses.is_rotation(rotation, ROTATION_TOLERANCE), "its rotation is none (orthonormal rows, determinant +1)"),
        ((np.abs(translation) <= FARTHEST).all(1), f"lies beyond {FARTHEST:g} m; the file's unit is not the format's"),
    ]
    for holds, complaint in laws:
        if not holds.all():
            raise InputError(f"{place(int(np.flatnonzero(~holds)[0]))}: {complaint}.")
    return poses.from_rotation_translation(rotation, translation)


def csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The lines of a CSV file that are not empty: their number and their words.

    Raises:
        InputError: a line is no CSV.
        OSError: the file cannot be read.
    """
    with open(path, encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = csv.reader(file)
        try:
            yield from ((lines.line_num, [word.strip() for word in words]) for words in lines if words)
        except csv.Error as error:
            raise InputError(f"{path}: line {lines.line_num}: {error}.") from None


def image_id(scene: int, image: int) -> str:
    """The name by which gt.json and preds.json know an image that has two numbers."""
    return f"{scene:06d}-{image:06d}"
