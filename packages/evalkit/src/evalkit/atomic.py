"""Files that are either complete or absent: written under a temporary name, synced, then renamed into place."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def atomic_path(path: Path | str, new: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it into place on success, remove it on any failure.

    A `new` file does not replace one that is there: of several writers at once the first wins. What is there and no
    file, such as /dev/null or a pipe, is written to and stays.

    Raises:
        FileExistsError: the file was to be `new`, and is there already.
        OSError: the folder cannot be made or written; `filename` names `path`, not the temporary.
    """
    path = Path(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder) / path.name
            with open(Path(folder) / path.name, "rb") as written, open(path, "wb") as device:
                shutil.copyfileobj(written, device)
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        _link(temporary, path) if new else os.replace(temporary, path)
    except OSError as error:
        if error.filename in (None, str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _link(temporary: Path, path: Path) -> None:
    """Give the file its second name, unless that is taken."""
    try:
        os.link(temporary, path)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS) or path.exists():
            raise
        os.replace(temporary, path)  # a file system without hard links


def write_text(path: Path | str, text: str, new: bool = False) -> None:
    """Write `text` atomically as UTF-8; `new` as in :func:`atomic_path`."""
    with atomic_path(path, new) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path | str, document: Any, indent: int | None = None, new: bool = False) -> None:
    """Write `document` atomically as JSON; NaN and infinity are refused, for no other reader takes them."""
    write_text(path, json.dumps(document, indent=indent, allow_nan=False) + "\n", new)


def sha256_of_file(path: Path | str) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() if hasattr(hashlib, "file_digest") else _sha256(file)


def _sha256(file: Any) -> str:
    digest = hashlib.sha256()
    while block := file.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
