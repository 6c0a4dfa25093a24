"""Whether shards are what they claim: intact bytes, and labels that obey the laws of :mod:`evalkit.datasets.scene`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.shard_damage import damage_named
from evalkit.datasets.shard_folder import DATASET_FILE, list_shards, read_dataset_file
from evalkit.datasets.shard_format import checksum_problem
from evalkit.datasets.shard_reader import ShardReader
from evalkit.errors import InputError
from simgen.building.label_laws import broken_laws, moved

PER_FRAME = ("scene_index", "view_index", "cam_from_world", "depth", "instance_id")


@dataclass(frozen=True)
class Problem:
    """One broken law: where, and in what words."""

    shard: str
    frame: int | None
    sentence: str

    def __str__(self) -> str:
        where = self.shard if self.frame is None else f"{self.shard}, frame {self.frame}"
        return f"{where}: {self.sentence}"


@dataclass(eq=False)
class Report:
    """What was looked at, and what was wrong with it."""

    shards: int = 0
    frames: int = 0
    scenes: set[int] = field(default_factory=set)
    visibility: list[NDArray[np.float32]] = field(default_factory=list)  # geometric
    problems: list[Problem] = field(default_factory=list)

    @property
    def summary(self) -> str:
        visibility = np.concatenate([np.zeros(0, np.float32), *self.visibility])
        seen = (
            f", {(visibility >= 0.5).mean():.0%} of them at least half visible (geometric)" if len(visibility) else ""
        )
        count = len(self.problems)
        verdict = f"{count} problem{'s' * (count > 1)}" if count else "all checksums and label laws hold"
        return (
            f"{self.shards} shards, {len(self.scenes)} scenes, {self.frames} frames, "
            f"{len(visibility)} labeled instances{seen}: {verdict}"
        )


def verify_shards(source: Path | str, on_shard: Callable[[Path], object] = lambda _: None) -> Report:
    """Check every shard of a folder, or one shard file; `on_shard` is called after each.

    Raises:
        InputError: there is nothing to check.
    """
    report = Report()
    paths = _existing_shards(Path(source), report)
    seen: dict[str, str] = {}
    for path in paths:
        report.shards += 1
        problem = checksum_problem(path)
        if problem is not None:
            report.problems.append(Problem(path.name, None, f"{problem}; delete it and run 'simgen build' again."))
        try:
            _verify_shard(path, report, seen)
        except InputError as error:
            report.problems.append(Problem(path.name, None, str(error)))
        on_shard(path)
    return report


def _existing_shards(source: Path, report: Report) -> list[Path]:
    """The shards that are there; those that dataset.json names and that are not are problems."""
    if not (source / DATASET_FILE).is_file():
        return list_shards(source)
    document = read_dataset_file(source)
    listed = {shard["name"]: shard for shard in document["shards"]}
    found = {path.name: path for path in sorted(source.glob("shard-*.h5"))}
    for name in sorted(set(listed) - set(found)):
        report.problems.append(Problem(name, None, "is missing; run the same 'simgen build' again to complete it."))
    for name in sorted(set(found) - set(listed)):
        report.problems.append(Problem(name, None, f"does not belong to the dataset that {DATASET_FILE} describes."))
    for name, path in found.items():
        if name in listed:
            report.problems += _against_dataset_file(path, document, listed[name])
    return list(found.values())


def _against_dataset_file(path: Path, document: dict[str, Any], entry: dict[str, Any]) -> Iterator[Problem]:
    """Whether a shard is of the build that dataset.json describes."""
    try:
        with ShardReader(path) as reader:
            head, scenes, schema = reader.header, reader.scene_index, reader.schema
    except InputError:
        return  # reported when the shard itself is read
    stated = {"schema": schema, "camera": head.camera.to_json(), "config": head.config, "seed": head.seed}
    for name, actual in stated.items():
        if document.get(name) != actual:
            yield Problem(path.name, None, f"its {name} is not that of {DATASET_FILE}; use shards of one build.")
    first, end = entry.get("scenes", (None, None))
    if first is not None and not ((first <= scenes) & (scenes < end)).all():
        yield Problem(path.name, None, f"holds scenes beyond the {first} to {end - 1} that {DATASET_FILE} names.")


def _verify_shard(path: Path, report: Report, seen: dict[str, str]) -> None:
    """Check one shard's structure, then frame by frame; `seen` maps image ids to the shard that has them."""
    structure = [Problem(path.name, None, sentence) for sentence in broken_structure(path)]
    report.problems += structure
    if structure:
        return
    with ShardReader(path) as reader:
        at_rest: dict[int, tuple[NDArray[np.int32], NDArray[np.float64]]] = {}
        for frame in range(len(reader)):
            image_id = reader.image_id(frame)
            if image_id in seen:
                report.problems.append(Problem(path.name, frame, f"image {image_id} is in {seen[image_id]} already."))
            seen[image_id] = path.name
            view = reader[frame]
            noisy = reader.header.config.get("sensor") is not None
            broken = [*broken_laws(view, reader.header.object, noisy), *moved(view, reader.header.object, at_rest)]
            report.problems += [Problem(path.name, frame, sentence) for sentence in broken]
            report.frames += 1
            report.scenes.add(view.scene_index)
            report.visibility.append(view.instances.visibility_geometric)


def broken_structure(path: Path | str) -> Iterator[str]:
    """What does not fit together in a shard's arrays, in sentences.

    Raises:
        InputError: the file cannot be read.
    """
    with ShardReader(path):  # raises where the file is no shard
        pass
    with damage_named(path), h5py.File(path, "r") as file:
        yield from _misfits(file)


def _misfits(file: Any) -> Iterator[str]:
    offset = np.asarray(file["frame_offset"])
    frames = len(file["scene_index"])
    for name in (*PER_FRAME, *(("depth_ideal",) if "depth_ideal" in file else ())):
        if len(file[name]) != frames:
            yield f"{name} holds {len(file[name])} frames where there are {frames}."
    rows = len(file["instance"])
    if len(offset) != frames + 1 or offset[0] != 0 or offset[-1] != rows or (np.diff(offset) < 0).any():
        yield f"frame_offset does not divide the {rows} labels among the {frames} frames."
