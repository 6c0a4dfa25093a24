"""The folder that a dataset is built in: claimed by one job, looked through for what is missing, kept clean."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.shard_folder import DATASET_FILE, read_dataset_file, shard_name, write_dataset_file
from evalkit.datasets.shard_format import SCHEMA, checksum_problem
from evalkit.datasets.shard_reader import ShardReader
from evalkit.errors import InputError
from simgen.scenes.identity import first_difference, identity, identity_of
from simgen.scenes.job import Job
from simgen.scenes.software import only_physics


def claim(folder: Path, job: Job) -> None:
    """Name the dataset in the folder before any shard, so that no other config can be mixed in.

    Raises:
        InputError: it is no folder, or belongs to another dataset, or to an unknown one, or to another physics engine.
        OSError: it cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; choose a folder with -o.")
    folder.mkdir(parents=True, exist_ok=True)
    header, entries = job.header, _entries(job)
    if not (folder / DATASET_FILE).exists():
        if any(folder.glob("shard-*.h5")):
            raise InputError(f"{folder}: holds shards but no {DATASET_FILE}; choose another folder with -o.")
        with contextlib.suppress(FileExistsError, FileNotFoundError):  # others, who started at the same moment, did
            write_dataset_file(folder, header, entries)
    document = read_dataset_file(folder)
    difference = first_difference(identity(document.get("config"), document.get("object")), job.identity)
    rest = {"camera": header.camera.to_json(), "depth_unit": header.depth_unit, "seed": header.seed, "shards": entries}
    difference = difference or first_difference({name: document.get(name) for name in rest}, rest)
    if difference is not None:
        require_own_schema(folder)  # an older simgen's configs lack fields, too, which would be named in its place
        raise InputError(
            f"{folder}: holds another dataset ({difference}); choose another folder with -o, "
            "or repeat the command that this one was built with."
        )
    _require_same_physics(folder, document.get("software"), header.software)


def _require_same_physics(folder: Path, recorded: Any, here: dict[str, str]) -> None:
    """Raise InputError where what made the folder's piles would make others here."""
    theirs = only_physics(recorded if isinstance(recorded, dict) else {})
    ours = only_physics(here)
    if theirs != ours:
        there, now = (", ".join(f"{name} {value}" for name, value in found.items()) for found in (theirs, ours))
        raise InputError(
            f"{folder}: its piles were made by {there or 'an unknown engine'}, and {now or 'none'} here would make "
            "others; go on where that is installed, or choose another folder with -o."
        )


def unfinished(folder: Path, job: Job, shards: range) -> tuple[list[int], list[int]]:
    """Those of the shards that are not there, and those that are there but damaged."""
    missing, damaged, schema = [], [], read_dataset_file(folder).get("schema")
    for shard in shards:
        path = folder / shard_name(shard)
        scenes = np.repeat(job.config.scenes_of_shard(shard), job.config.views)
        if not path.exists():
            missing.append(shard)
        elif not _is_intact(path, job.identity, schema, scenes):
            damaged.append(shard)
    return missing, damaged


def require_own_schema(folder: Path) -> None:
    """Shards written here are of the schema that the folder's other shards have.

    Raises:
        InputError: the dataset was begun with another.
    """
    begun = read_dataset_file(folder).get("schema")
    if begun != SCHEMA:
        raise InputError(
            f"{folder}: was begun with shards of schema {begun}, and this simgen writes {SCHEMA}; complete it with the "
            "simgen that began it, or build it anew in another folder with -o."
        )


@contextlib.contextmanager
def no_leftovers(folder: Path, shards: range) -> Iterator[None]:
    """Remove the temporary files of killed builds of these shards, before and after; the caller holds their locks."""
    _remove_leftovers(folder, shards)
    try:
        yield
    finally:
        _remove_leftovers(folder, shards)


def _entries(job: Job) -> list[dict[str, Any]]:
    """What dataset.json says of each shard."""
    config, entries = job.config, []
    for shard in range(config.shards):
        numbers = config.scenes_of_shard(shard)
        entries.append({"name": shard_name(shard), "scenes": [numbers.start, numbers.stop]})
    return entries


def _is_intact(path: Path, own: dict[str, Any], schema: Any, scenes: NDArray[np.int64]) -> bool:
    """Whether a shard is whole, of this build and schema, and holds these scenes, frame by frame (F,)."""
    if checksum_problem(path) is not None:
        return False
    try:
        with ShardReader(path) as reader:
            own_build = reader.schema == schema and identity_of(reader.header) == own
            return own_build and np.array_equal(reader.scene_index, scenes)
    except InputError:
        return False


def _remove_leftovers(folder: Path, shards: range) -> None:
    names = [DATASET_FILE] * (len(shards) > 0)  # which is there, so that nobody needs another
    names += [shard_name(shard) for shard in shards]
    for leftover in folder.glob(".*.tmp"):
        if any(leftover.name.startswith(f".{name}.") for name in names):
            leftover.unlink(missing_ok=True)
