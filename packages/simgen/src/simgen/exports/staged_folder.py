"""A folder that appears when it is complete: filled beside its place, where the next attempt finds what there is."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from evalkit.atomic import write_json
from evalkit.errors import InputError

NOTE = ".unfinished.json"


@contextlib.contextmanager
def staged_folder(folder: Path, content: dict[str, Any]) -> Iterator[Path]:
    """Yield FOLDER.part to fill; it becomes `folder` at the end, and stays as it is if anything goes wrong.

    Args:
        content: JSON that says what will be in it; what an earlier attempt left must say the same.

    Raises:
        InputError: `folder` is there and not empty, another process is filling it, or an attempt left something else.
        OSError: the place cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; choose another folder.")
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder}: is not empty; choose another folder, or delete this one.")
    part = folder.resolve().with_name(f"{folder.resolve().name}.part")
    part.mkdir(parents=True, exist_ok=True)
    with _alone_in(part):
        _claim(part, content)
        yield part
        (part / NOTE).unlink()
        os.replace(part, folder.resolve())


def _claim(part: Path, content: dict[str, Any]) -> None:
    note = part / NOTE
    if not any(part.iterdir()):
        write_json(note, content)
    try:
        known = json.loads(note.read_text(encoding="utf-8"))
    except (FileNotFoundError, UnicodeDecodeError, json.JSONDecodeError):
        known = None
    if known != content:
        raise InputError(f"{part}: holds something else, unfinished; delete it, or choose another folder.")


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system drops when this process ends, however it ends."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another process is at work in it; wait, or choose another folder.") from None
        yield
    finally:
        os.close(handle)
