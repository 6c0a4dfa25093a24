"""From a job to a folder of shards: in parallel, resumable, and with the same bytes every time.

A shard is one task: simulated, rendered and written by one process. Nothing that a task computes depends on another,
so that workers, order and interruptions do not show in the result.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.scene import Scene
from evalkit.shards import (
    DATASET_FILE,
    ShardReader,
    ShardWriter,
    checksum_problem,
    read_dataset_file,
    shard_name,
    write_dataset_file,
)
from simgen.identity import first_difference, identity, own_identity
from simgen.local_pool import count_scene, processes_here
from simgen.progress import SceneProgress
from simgen.scenes import Job, SceneRenderer
from simgen.tasks import run_tasks
from simgen.viewpoints import draw_viewpoints


@dataclass(frozen=True)
class ShardReport:
    """One finished shard: scenes in it, and drops that had to be thrown away."""

    shard: int
    scenes: int
    redone: int


@dataclass
class BuildReport:
    """What a build did: shards found complete, rebuilt because damaged, written; scenes redone; pools that broke."""

    kept: int = 0
    damaged: list[str] = field(default_factory=list)
    written: list[ShardReport] = field(default_factory=list)
    broken_pools: int = 0

    @property
    def redone(self) -> int:
        return sum(report.redone for report in self.written)


def build(job: Job, folder: Path, workers: int) -> BuildReport:
    """Complete the dataset in `folder`: write the shards that are missing or damaged, leave the others alone.

    Raises:
        InputError: the folder holds another dataset, another build is at work in it, or workers keep dying.
        OSError: the folder cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; choose a folder with -o.")
    folder.mkdir(parents=True, exist_ok=True)
    with _alone_in(folder):
        _claim(folder, job)
        _remove_leftovers(folder)
        report = BuildReport()
        missing = _missing_shards(folder, job, report)
        if missing:
            _compile(job)
            try:
                with SceneProgress(_scenes(job, missing)) as progress:
                    _build_shards(job, folder, missing, workers, report, progress)
            finally:
                _remove_leftovers(folder)
    return report


def build_shard(job: Job, folder: Path, shard: int) -> ShardReport:
    """Simulate, render and write one shard; the unit of work that a local process or a cluster's worker gets."""
    numbers = job.config.scenes_of_shard(shard)
    renderer, redone = SceneRenderer(job), 0
    frames = len(numbers) * job.config.views
    path, ideal = folder / shard_name(shard), job.config.keep_ideal
    with ShardWriter(path, job.header(), frames, job.config.compression, ideal) as writer:
        for number in numbers:
            scene, attempts = job.scene(number)
            redone += attempts - 1
            for view in renderer.views(scene):
                writer.append(view)
            count_scene(attempts - 1)
    return ShardReport(shard, len(numbers), redone)


def _claim(folder: Path, job: Job) -> None:
    """Name the dataset in the folder before any shard, so that no other config can be mixed in.

    Raises:
        InputError: the folder belongs to another dataset, or to an unknown one.
    """
    header = job.header()
    shards = [
        {"name": shard_name(shard), "scenes": [numbers.start, numbers.stop]}
        for shard in range(job.config.shards)
        for numbers in [job.config.scenes_of_shard(shard)]
    ]
    if (folder / DATASET_FILE).exists():
        document = read_dataset_file(folder)
        difference = first_difference(identity(document.get("config"), document.get("object")), own_identity(job))
        rest = {"camera": header.camera.to_json(), "depth_unit": header.depth_unit, "seed": header.seed}
        rest |= {"shards": shards}
        difference = difference or first_difference({name: document.get(name) for name in rest}, rest)
        if difference is not None:
            raise InputError(
                f"{folder}: holds another dataset ({difference}); choose another folder with -o, "
                "or repeat the command that this one was built with."
            )
        return
    if any(folder.glob("shard-*.h5")):
        raise InputError(f"{folder}: holds shards but no {DATASET_FILE}; choose another folder with -o.")
    write_dataset_file(folder, header, shards)


def _missing_shards(folder: Path, job: Job, report: BuildReport) -> list[int]:
    missing, own = [], own_identity(job)
    for shard in range(job.config.shards):
        path = folder / shard_name(shard)
        scenes = np.repeat(job.config.scenes_of_shard(shard), job.config.views)
        if path.exists() and _is_intact(path, own, scenes):
            report.kept += 1
            continue
        missing.append(shard)
        if path.exists():
            report.damaged.append(path.name)
    return missing


def _is_intact(path: Path, own: dict[str, Any], scenes: NDArray[np.int64]) -> bool:
    """Whether a shard is whole, of this build, and holds these scenes, frame by frame (F,)."""
    if checksum_problem(path) is not None:
        return False
    try:
        with ShardReader(path) as reader:
            ours = identity(reader.header.config, reader.header.object.to_json()) == own
            return ours and np.array_equal(reader.scene_index, scenes)
    except InputError:
        return False


def _remove_leftovers(folder: Path) -> None:
    """Remove what a killed build was writing; nobody else is at work here."""
    for pattern in (".shard-*.tmp", f".{DATASET_FILE}.*.tmp"):
        for leftover in folder.glob(pattern):
            leftover.unlink(missing_ok=True)


def _scenes(job: Job, shards: Iterable[int]) -> int:
    return sum(len(job.config.scenes_of_shard(shard)) for shard in shards)


def _compile(job: Job) -> None:
    """Render one instance here, so that the workers find the compiled code instead of each compiling it."""
    camera = draw_viewpoints(job.config.viewpoints, job.config.camera, job.bin, job.model.diameter, 0, 0, 1)
    for _ in SceneRenderer(job).views(Scene(0, np.eye(4)[None], camera)):
        pass


def _build_shards(
    job: Job, folder: Path, shards: list[int], workers: int, report: BuildReport, progress: SceneProgress
) -> None:
    def submit(executor: Executor, shard: int) -> Future[ShardReport]:
        return executor.submit(build_shard, job.for_shard(shard), folder, shard)

    report.broken_pools = run_tasks(processes_here(workers), shards, submit, report.written.append, progress)


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system drops when this process ends, however it ends."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{folder}: another 'simgen build' is at work in this folder; wait for it or choose another with -o."
            ) from None
        yield
    finally:
        os.close(handle)
