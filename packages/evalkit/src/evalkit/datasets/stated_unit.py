"""A unit that a document states: lengths are meters here, and others must not be read as if they were."""

from __future__ import annotations

from typing import Any

from evalkit.errors import InputError, shortened

FIELDS = ("unit", "units", "length_unit", "translation_unit")
METERS = ("m", "meter", "meters", "metre", "metres")


def require_meters(document: Any, where: str) -> None:
    """Refuse a part of a document that says its lengths are not in meters; who says nothing means meters.

    Raises:
        InputError: it states another unit.
    """
    if not isinstance(document, dict):
        return
    for field in FIELDS:
        stated = document.get(field)
        if stated is not None and str(stated).strip().lower() not in METERS:
            raise InputError(
                f"{where}: its '{field}' is {shortened(stated)}, and lengths are meters here; convert them, and leave "
                "the field out."
            )
