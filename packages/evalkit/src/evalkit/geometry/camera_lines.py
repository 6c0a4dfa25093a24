"""Camera files of lines: numbers alone, words with numbers, sections as INI files have them, COLMAP's rows."""

from __future__ import annotations

import re
from typing import Any

COMMENTS = ("#", ";", "%", "//")
SHARED = "image"  # the section of ROS's videre files whose entries belong to the cameras after it
OF_ONE_CAMERA = re.compile(r"(intrinsics?|distort(ion)?|coefficients|params?)$")  # ends of Orbbec's sections' names
SEPARATORS = re.compile(r"[\s,;=\[\]()]+")


class ColmapRows(dict[str, dict[str, Any]]):
    """The rows of a COLMAP cameras.txt by their number: model, width, height and parameters as a list."""


def read_lines(text: str) -> Any:
    """A document of what lines say: a list of rows, or entries by their names, in sections or not.

    Raises:
        ValueError: an entry stands twice.
    """
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith(COMMENTS)]
    rows = [[number_of(word) for word in SEPARATORS.split(line) if word] for line in lines]
    rows = [row for row in rows if row]
    if rows and not any(isinstance(value, str) for row in rows for value in row):
        return rows if len(rows) > 1 else rows[0]
    if rows and all(len(row) >= 5 and isinstance(row[0], int) and str(row[1]).isupper() for row in rows):
        return ColmapRows((str(row[0]), {"model": row[1], "size": row[2:4], "values": row[4:]}) for row in rows)
    if len(rows) == 2 and _is_table(*rows):
        return dict(zip(rows[0], rows[1], strict=True))
    return _sections(lines)


def _is_table(heads: list[Any], values: list[Any]) -> bool:
    return (
        len(heads) == len(values) > 1
        and all(isinstance(head, str) for head in heads)
        and not any(isinstance(value, str) for value in values)
    )


def number_of(word: str) -> float | int | str:
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def _sections(lines: list[str]) -> dict[str, Any]:
    """Entries ``key value …``, ``key: value``, ``key = value``, or a key alone with its numbers in the lines below."""
    found: dict[str, Any] = {}
    entries, shared, key = found, dict[str, Any](), ""
    for line in lines:
        header = re.fullmatch(r"\[([^\[\]]+)\]", line)
        if header and isinstance(number_of(header[1].split(",")[0].split()[0]), str):
            name = header[1].strip()
            stem = OF_ONE_CAMERA.sub("", name.lower())
            entries = {} if name == SHARED else found.setdefault(stem or name, {})
            shared = entries if name == SHARED else shared
            if name != SHARED:
                _add(entries, shared)
            continue
        words = [word for word in re.split(r"[\s,;\[\]()]+|(?<=\w)\s*[=:]\s*", line) if word and word not in "=:"]
        values = [number_of(word) for word in words]
        if not values:
            continue
        if not isinstance(values[0], str):  # a row of what the key above it names
            entries[key] = [*_listed(entries.get(key, [])), *values]
        elif len(values) > 1 and not all(isinstance(value, str) for value in values):
            first = next(i for i, value in enumerate(values) if not isinstance(value, str))
            rest = values[first:]
            _add(entries, {" ".join(map(str, values[:first])): rest[0] if len(rest) == 1 else rest})
            key = " ".join(map(str, values[:first]))
        elif re.search(r"[=:]\s*\S", line) or (len(values) == 2 and "_" in values[0]):
            _add(entries, {str(values[0]): " ".join(map(str, values[1:]))})
        else:
            key = line.rstrip(":= ")
            entries.setdefault(key, [])
    return _single(found)


def _add(entries: dict[str, Any], more: dict[str, Any]) -> None:
    for key, value in more.items():
        if key in entries and entries[key] != value:
            raise ValueError(f"the field '{key}' stands twice, with different values")
        entries[key] = value


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _single(entries: dict[str, Any]) -> dict[str, Any]:
    """Lists of one number as that number."""
    return {
        key: _single(value)
        if isinstance(value, dict)
        else value[0]
        if isinstance(value, list) and len(value) == 1
        else value
        for key, value in entries.items()
    }
