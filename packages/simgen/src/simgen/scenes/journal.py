"""Scenes that are simulated already, kept while the rest is: a line of JSON for every finished task.

A line that was cut short, by a kill or a full disk, is dropped with all after it; the file is locked while in use.
"""

from __future__ import annotations

import base64
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

Array = NDArray[np.float64]
SUFFIX = ".partial"


@dataclass(frozen=True, eq=False)
class SimulatedScenes:
    """The scenes of one task: `world_from_obj` (n_s, 4, 4) of each, and the drops that each took."""

    task: int
    world_from_obj: list[Array]
    attempts: list[int]

    @property
    def scenes(self) -> int:
        return len(self.attempts)

    @property
    def redone(self) -> int:
        return sum(self.attempts) - self.scenes


class SceneJournal:
    """The open journal of one dataset's scenes; make it with :func:`scene_journal`."""

    def __init__(self, handle: int, finished: dict[int, SimulatedScenes]) -> None:
        self._handle, self.finished = handle, finished

    def append(self, done: SimulatedScenes) -> None:
        """Keep a finished task."""
        _write(self._handle, _line(_to_json(done)))
        self.finished[done.task] = done


@contextmanager
def scene_journal(path: Path, identity: dict[str, Any]) -> Iterator[SceneJournal]:
    """Open the journal of the scenes file `path`, with what it holds of the dataset of that identity.

    Raises:
        InputError: it belongs to another dataset, or somebody else is at work on it.
        OSError: it cannot be written.
    """
    journal = path.with_name(path.name + SUFFIX)
    journal.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(journal, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{path}: another 'simgen simulate' is writing it; wait for it or choose another with -o."
            ) from None
        yield SceneJournal(handle, _resume(handle, journal, identity))
    except OSError as error:
        raise OSError(error.errno, error.strerror, error.filename or str(journal)) from error
    finally:
        os.close(handle)


def _resume(handle: int, journal: Path, identity: dict[str, Any]) -> dict[int, SimulatedScenes]:
    """Read the sound lines, and cut off what follows them."""
    head = _line({"of": hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()})
    with os.fdopen(os.dup(handle), "rb") as file:
        first = file.readline()
        if first.endswith(b"\n") and first != head:
            raise InputError(f"{journal}: holds scenes of another config; delete it or choose another file with -o.")
        finished, sound = dict[int, SimulatedScenes](), len(first)
        if first == head:
            for line in file:
                done = _from_line(line)
                if done is None:
                    break
                finished[done.task], sound = done, sound + len(line)
    if first != head:
        os.ftruncate(handle, 0)
        _write(handle, head)
    else:
        os.ftruncate(handle, sound)
    os.lseek(handle, 0, os.SEEK_END)
    return finished


def _to_json(done: SimulatedScenes) -> dict[str, Any]:
    rows = np.concatenate(done.world_from_obj)[:, :3].astype("<f8")
    return {
        "task": done.task,
        "attempts": done.attempts,
        "instances": [len(scene) for scene in done.world_from_obj],
        "poses": base64.b64encode(rows.tobytes()).decode(),
    }


def _line(document: dict[str, Any]) -> bytes:
    """JSON and its checksum."""
    text = json.dumps(document)
    return f"{hashlib.sha256(text.encode()).hexdigest()} {text}\n".encode()


def _from_line(line: bytes) -> SimulatedScenes | None:
    """What :func:`_line` wrote; None for a line that is not as it was written."""
    digest, _, text = line.partition(b" ")
    if not line.endswith(b"\n") or hashlib.sha256(text[:-1]).hexdigest().encode() != digest:
        return None
    document = json.loads(text)
    rows = np.frombuffer(base64.b64decode(document["poses"]), "<f8").reshape(-1, 3, 4)
    every = np.concatenate([rows, np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1, 1))], axis=1)
    return SimulatedScenes(
        document["task"], np.split(every, np.cumsum(document["instances"])[:-1]), document["attempts"]
    )


def _write(handle: int, data: bytes) -> None:
    while data:
        data = data[os.write(handle, data) :]
