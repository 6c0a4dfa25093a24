"""A dataset's config out of the JSON that travels in its files."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from evalkit.errors import InputError
from evalkit.typed import typed
from simgen.config import BuildConfig


def config_from_json(document: Any, where: str) -> BuildConfig:
    """Read what :meth:`BuildConfig.to_json` wrote; entries that are none of its fields are left aside.

    Raises:
        InputError: a field is missing, unknown to this version, or of the wrong type; `where` names the place.
    """
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected the config of a dataset.")
    known = {field.name for field in fields(BuildConfig)}  # a header adds entries of its own
    return typed(BuildConfig, {name: value for name, value in document.items() if name in known}, where)
