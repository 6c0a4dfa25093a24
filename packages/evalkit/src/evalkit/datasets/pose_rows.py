"""Lists of poses in JSON, ``[{"R", "t", value}]``: as arrays and back, checked, with the first fault named."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses

Array = NDArray[np.float64]

ROTATION_TOLERANCE = 5e-3  # published matrices are rounded to as few as three digits
FARTHEST = 50.0  # meters; a bin-picking camera looks at nothing beyond, but millimeters read as meters lie there


class Rows(NamedTuple):
    """Instances or hypotheses of one image as arrays."""

    rotation: Array  # (n, 3, 3)
    translation: Array  # (n, 3)
    value: Array  # (n,) visibility or score
    optional: dict[str, Array]  # (n,) each, by field


class Layout(NamedTuple):
    """How a document calls its rows and the value of each: it differs between gt.json and preds.json."""

    format: str
    rows: str
    row: str
    value: str
    optional: tuple[str, ...] = ()  # fields of numbers that all rows of an image have, or none


def parse_rows(rows: Any, value_field: str, where: str) -> tuple[Array, Array]:
    """A list of ``{"R", "t", value_field}`` of anybody's to poses (n, 4, 4) and values (n,), checked like our own.

    Raises:
        InputError: an entry lacks a field, or holds what is no rotation or no number of meters.
    """
    layout = Layout("", "list of poses", "entry", value_field)
    arrays = to_arrays(rows, layout) if isinstance(rows, list) else None
    if arrays is None:
        raise InputError(f"{where}: {first_fault(rows, layout)}")
    return checked_poses([where], [arrays], layout)[0], arrays.value


def row_dicts(cam_from_obj: Array, **values: Array) -> list[dict[str, Any]]:
    """Poses (n, 4, 4) and values (n,) by their field's name as ``[{"R", "t", ...}]``."""
    pose = np.asarray(cam_from_obj, float).reshape(-1, 4, 4)
    columns = {"R": pose[:, :3, :3], "t": pose[:, :3, 3]} | {key: np.asarray(v, float) for key, v in values.items()}
    listed = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in listed]


def to_arrays(rows: list[Any], layout: Layout) -> Rows | None:
    rotation, translation, value = _column(rows, "R", (3, 3)), _column(rows, "t", (3,)), _column(rows, layout.value, ())
    optional = {key: _column(rows, key, ()) for key in _given(rows, layout)}
    known = {key: column for key, column in optional.items() if column is not None}
    if rotation is None or translation is None or value is None or len(known) < len(optional):
        return None
    return Rows(rotation, translation, value, known)


def _given(rows: Any, layout: Layout) -> list[str]:
    """The optional fields that the first row has, and that so all must have."""
    first = rows[0] if rows else None
    return [key for key in layout.optional if isinstance(first, dict) and key in first]


def _column(rows: list[Any], key: str, shape: tuple[int, ...]) -> Array | None:
    """One field of all rows as an array (n, *shape), None unless every one is there and holds numbers only."""
    if not rows:
        return np.zeros((0, *shape))
    try:
        column = np.array([row[key] for row in rows])
    except (KeyError, TypeError, ValueError, OverflowError, IndexError):
        return None
    fits = column.dtype.kind in "iuf" and column.shape == (len(rows), *shape)
    return column.astype(np.float64) if fits else None


def first_fault(rows: Any, layout: Layout) -> str:
    """What is wrong with an image's rows, which :func:`to_arrays` refused."""
    if not isinstance(rows, list):
        return f"the field '{layout.rows}' must be a list."
    numbers = [(key, (), "a number") for key in (layout.value, *_given(rows, layout))]
    wanted = [("R", (3, 3), "a 3x3 matrix of numbers"), ("t", (3,), "three numbers"), *numbers]
    for index, row in enumerate(rows):
        if not isinstance(row, dict):
            return f"{layout.row} {index} must be an object with 'R', 't' and '{layout.value}'."
        for key, shape, words in wanted:
            if key not in row:
                return f"{layout.row} {index}: the field '{key}' is missing."
            if _column([row], key, shape) is None:
                return f"{layout.row} {index}: the field '{key}' must be {words}."
    return f"the field '{layout.rows}' mixes kinds of values."


def checked_poses(
    names: Sequence[str], rows: Sequence[Rows], layout: Layout, center: Array | None = None
) -> list[Array]:
    """The images' poses (n, 4, 4), checked in one go; `names` names the images in messages.

    `center` (3,) is a point of the object: how far off it is counts, for a mesh's origin may lie anywhere. Without it
    that is the origin.
    """
    counts = [len(row.value) for row in rows]
    mend = "" if center is not None else "; where the mesh's origin lies so far off, the object's 'box_center' as well"
    rotation = np.concatenate([row.rotation for row in rows] or [np.zeros((0, 3, 3))])
    translation = np.concatenate([row.translation for row in rows] or [np.zeros((0, 3))])
    value = np.concatenate([row.value for row in rows] or [np.zeros(0)])
    laws = [
        (np.isfinite(rotation).all((1, 2)), "'R' holds a number that is not finite"),
        (np.isfinite(translation).all(1), "'t' holds a number that is not finite"),
        (np.isfinite(value), f"'{layout.value}' is not finite"),
        (poses.is_rotation(rotation, ROTATION_TOLERANCE), "'R' is not a rotation (orthonormal rows, determinant +1)"),
        (_near(rotation, translation, center), f"'t' lies beyond {FARTHEST:g} m; give meters, not millimeters{mend}"),
    ]
    for holds, complaint in laws:
        if not holds.all():
            first = int(np.flatnonzero(~holds)[0])
            image = int(np.searchsorted(np.cumsum(counts), first, side="right"))
            number = first - sum(counts[:image])
            raise InputError(f"{names[image]}: {layout.row} {number}: the field {complaint}.")
    stacked = poses.from_rotation_translation(rotation, translation)
    return np.split(stacked, np.cumsum(counts)[:-1]) if counts else []


def _near(rotation: Array, translation: Array, center: Array | None) -> NDArray[np.bool_]:
    """Which of the poses (n, 3, 3) and (n, 3) leave the object where a bin-picking camera could see it, as (n,)."""
    place = translation if center is None else rotation @ center + translation
    return np.asarray((np.abs(place) <= FARTHEST).all(1))
