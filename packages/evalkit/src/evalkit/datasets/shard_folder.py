"""A dataset on disk: a folder of shards and its dataset.json, read as one sequence of views."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import write_json
from evalkit.datasets.scene import View
from evalkit.datasets.shard_format import SCHEMA, ShardHeader
from evalkit.datasets.shard_reader import ShardReader
from evalkit.errors import InputError

DATASET_SCHEMA = "binpose-dataset/1"
DATASET_FILE = "dataset.json"


def shard_name(index: int) -> str:
    return f"shard-{index:05d}.h5"


class ShardDataset(Sequence[View]):
    """All frames of a folder of shards (or of listed shard files) as one sequence of :class:`View`.

    Safe to hand to worker processes: files are opened anew in each process, on first use.

    Raises:
        InputError: there is no shard, one is missing or damaged, or they differ in schema, object, camera or unit.
    """

    def __init__(self, source: Path | str | Sequence[Path | str]) -> None:
        self.paths = list_shards(source)
        self._readers: dict[int, ShardReader] = {}
        self._pid = os.getpid()
        lengths = []
        for index in range(len(self.paths)):
            reader = self.reader(index)
            _require_same(self.reader(0), reader)
            lengths.append(len(reader))
        self.header = self.reader(0).header
        self._starts = np.cumsum([0, *lengths])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        reader, frame = self.locate(index)
        return reader[frame]

    def locate(self, index: int) -> tuple[ShardReader, int]:
        """The shard that holds frame `index`, and the frame's number in it."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        index %= len(self)
        shard = int(np.searchsorted(self._starts, index, side="right")) - 1
        return self.reader(shard), index - int(self._starts[shard])

    def reader(self, shard: int) -> ShardReader:
        """The open reader of one shard, this process's own."""
        if self._pid != os.getpid():
            self._readers, self._pid = {}, os.getpid()
        if shard not in self._readers:
            self._readers[shard] = ShardReader(self.paths[shard])
        return self._readers[shard]

    @property
    def scene_index(self) -> NDArray[np.int32]:
        """Scene of each frame (len(self),)."""
        return np.concatenate([self.reader(shard).scene_index for shard in range(len(self.paths))])

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_readers": {}}


def list_shards(source: Path | str | Sequence[Path | str]) -> list[Path]:
    """Shard files of a folder, one shard file, or a list of either.

    Raises:
        InputError: nothing is there, or dataset.json names shards that are missing.
    """
    if not isinstance(source, str | Path):
        return [path for part in source for path in list_shards(part)]
    source = Path(source)
    if source.is_file():
        return [source]
    if not source.is_dir():
        raise InputError(f"{source}: no such folder or shard; build one with 'simgen build -o {source}'.")
    found = sorted(source.glob("shard-*.h5"))
    if (source / DATASET_FILE).is_file():
        expected = {shard["name"] for shard in read_dataset_file(source)["shards"]}
        missing = sorted(expected - {path.name for path in found})
        if missing:
            raise InputError(
                f"{source}: {len(missing)} of {len(expected)} shards are missing (first: {missing[0]}); "
                "run the same 'simgen build' again to complete it."
            )
        found = [path for path in found if path.name in expected]
    if not found:
        raise InputError(f"{source}: the folder holds no shards (shard-*.h5); build some with 'simgen build'.")
    return found


def read_dataset_file(folder: Path | str) -> dict[str, Any]:
    """The parsed dataset.json of a folder.

    Raises:
        InputError: it is missing, not JSON, or of another schema.
    """
    path = Path(folder) / DATASET_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        known = document["format"] == DATASET_SCHEMA and all(isinstance(s["name"], str) for s in document["shards"])
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; build the folder with 'simgen build'.") from None
    except (ValueError, KeyError, TypeError, RecursionError):  # not UTF-8, not JSON, a number of 5000 digits …
        known = False
    if not known:
        raise InputError(f"{path}: not a {DATASET_SCHEMA} file; move the folder away and build it again.")
    return dict(document)


def write_dataset_file(folder: Path | str, header: ShardHeader, shards: list[dict[str, Any]]) -> None:
    """Write dataset.json: `shards` lists {"name", "scenes": [first, end]} of every shard that belongs.

    Raises:
        FileExistsError: there is one, perhaps since a moment ago.
    """
    document = {
        "format": DATASET_SCHEMA,
        "schema": SCHEMA,
        "camera": header.camera.to_json(),
        "depth_unit": header.depth_unit,
        "object": _in_order(header.object.to_json()),
        "config": _in_order(header.config),
        "seed": header.seed,
        "software": _in_order(header.software),
        "shards": shards,
    }
    write_json(Path(folder) / DATASET_FILE, document, indent=1, new=True)


def _in_order(document: dict[str, Any]) -> Any:
    """The same with its keys in the order in which shards have them, so that wherever it comes from its bytes agree."""
    return json.loads(json.dumps(document, sort_keys=True))


def _require_same(first: ShardReader, other: ShardReader) -> None:
    a, b = first.header, other.header
    if first.schema != other.schema:
        raise InputError(
            f"{other.path}: is of schema {other.schema}, {first.path} of {first.schema}; use shards of one schema."
        )
    same = (
        a.camera == b.camera
        and a.depth_unit == b.depth_unit
        and a.object.name == b.object.name
        and abs(a.object.diameter - b.object.diameter) < 1e-9
        and a.object.symmetry.name == b.object.symmetry.name
    )
    if not same:
        raise InputError(
            f"{other.path}: its object, camera or depth unit differs from {first.path}'s; use shards of one build."
        )
