"""What preds.json says of the object that its poses are of: a name, or name, diameter and the center of its box."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evalkit.errors import InputError

LARGEST = 1e9  # seconds or meters; the integers that JSON may hold are no floats beyond 1e308


def checked_reference(path: Path | str, reference: Any) -> dict[str, Any] | str:
    """The field "object" of the document `path`.

    Raises:
        InputError: it is neither a name nor an object whose known fields are right.
    """
    name = reference.get("name") if isinstance(reference, dict) else reference
    if name is not None and not isinstance(name, str):
        raise InputError(f"{path}: the field 'object' must be the object's name, or hold its 'name'.")
    if not isinstance(reference, dict):
        return name or ""
    if not 0 < _number(reference.get("diameter", 1.0)) <= LARGEST:
        raise InputError(f"{path}: object: the field 'diameter' must be a positive number of meters.")
    center = reference.get("box_center")
    is_point = isinstance(center, list) and len(center) == 3 and all(abs(_number(x)) <= LARGEST for x in center)
    if center is not None and not is_point:
        raise InputError(f"{path}: object: the field 'box_center' must hold three numbers, meters.")
    return reference


def _number(value: Any) -> float:
    """NaN, which satisfies no comparison, for what is no number."""
    return value if isinstance(value, int | float) and not isinstance(value, bool) else float("nan")
