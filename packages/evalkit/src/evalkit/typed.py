"""Dataclasses out of JSON documents: each field of its annotated type, every refusal names its place."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from evalkit.errors import InputError

T = TypeVar("T")
_PLACE = re.compile(r" - at `\$\.?(?P<path>.*)`$")


def typed(kind: type[T], document: Any, where: str, *, complete: bool = True) -> T:
    """A dataclass, nested ones included, from the parsed JSON of one.

    Args:
        where: names the document in refusals, such as "shard-00000.h5: config".
        complete: every field must be there; otherwise a field that is missing has its default.

    Raises:
        InputError: a field is unknown, missing or of another type, or the dataclass itself refuses its values.
    """
    _require_fields(kind, document, where, complete)
    try:
        return msgspec.convert(document, kind, strict=True)
    except msgspec.ValidationError as error:
        found = _PLACE.search(str(error))
        path = found["path"] if found else ""
        raise InputError(f"{_inside(where, path)}: {_sentence(error, kind, path)}") from None


def _sentence(error: msgspec.ValidationError, kind: Any, path: str) -> str:
    """msgspec's words as ours: without its place, and with the values that a choice allows."""
    words = _PLACE.sub("", str(error)).replace("`", "")
    if isinstance(error.__cause__, InputError):
        return words
    return f"{words[:1].lower()}{words[1:].replace(' enum', '')}{_choices(kind, path.split('.'))}."


def _choices(kind: Any, path: list[str]) -> str:
    """Such as "; use one of box, metric", where the path leads to a choice of words."""
    for name in path:
        kind = get_type_hints(kind).get(name) if is_dataclass(kind) else None
    return f"; use one of {', '.join(map(str, get_args(kind)))}" if get_origin(kind) is Literal else ""


def _require_fields(kind: Any, document: Any, where: str, complete: bool) -> None:
    """Names alone; msgspec checks the values, but passes over names that it does not know."""
    nested = _nested(kind)
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected an object with the fields {', '.join(nested)}.")
    unknown = sorted(set(document) - set(nested))
    missing = sorted(set(nested) - set(document)) if complete else []
    if unknown or missing:
        name, fault = (unknown[0], "is unknown to") if unknown else (missing[0], "is missing, but needed by")
        raise InputError(f"{where}: the field '{name}' {fault} this version; use the version that wrote it.")
    for name, inner in nested.items():
        if inner is not None and document.get(name) is not None:
            _require_fields(inner, document[name], _inside(where, name), complete)


def _inside(where: str, path: str) -> str:
    return f"{where}.{path}" if path else where


@cache
def _nested(kind: Any) -> dict[str, Any]:
    """The fields of a dataclass, each with the dataclass that it holds, if it holds one."""
    hints = get_type_hints(kind)
    inner = {name: [t for t in (hint, *get_args(hint)) if is_dataclass(t)] for name, hint in hints.items()}
    return {field.name: next(iter(inner[field.name]), None) for field in fields(kind)}
