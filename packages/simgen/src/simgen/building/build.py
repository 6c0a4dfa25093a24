"""From a job to a folder of shards: in parallel, resumable, and with the same bytes every time.

A shard is one task: simulated, rendered and written by one process. Nothing that a task computes depends on another,
so that workers, order and interruptions do not show in the result.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Scene
from evalkit.datasets.shard_folder import DATASET_FILE, read_dataset_file, shard_name, write_dataset_file
from evalkit.datasets.shard_format import checksum_problem
from evalkit.datasets.shard_reader import ShardReader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.errors import InputError
from simgen.building.shard_locks import shards_locked
from simgen.rendering.viewpoints import draw_viewpoints
from simgen.scenes.identity import first_difference, identity, own_identity
from simgen.scenes.job import Job, SceneRenderer
from simgen.workers.local import count_scene, processes_here
from simgen.workers.progress import SceneProgress
from simgen.workers.tasks import Pool, run_tasks


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


def build(job: Job, folder: Path, workers: int, shards: range | None = None, dask: str | None = None) -> BuildReport:
    """Complete the dataset in `folder`: write the shards that are missing or damaged, leave the others alone.

    Args:
        workers: processes on this machine.
        shards: build these only; others may be at work on the rest, on other machines as well.
        dask: address of the scheduler of a cluster to compute on in place of these processes.

    Raises:
        InputError: the folder holds another dataset, another build is at work in it, or workers keep dying.
        OSError: the folder cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; choose a folder with -o.")
    folder.mkdir(parents=True, exist_ok=True)
    _claim(folder, job)
    shards = range(job.config.shards) if shards is None else shards
    with shards_locked(folder, shards) as alone, _no_leftovers(folder, shards if alone else range(0)):
        report = BuildReport()
        missing = _missing_shards(folder, job, shards, report)
        if missing:
            _compile(job)
            with _pool(workers, dask, folder) as pool, SceneProgress(_scenes(job, missing)) as progress:
                _build_shards(job, folder, missing, pool, report, progress)
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
    entries = [
        {"name": shard_name(shard), "scenes": [numbers.start, numbers.stop]}
        for shard in range(job.config.shards)
        for numbers in [job.config.scenes_of_shard(shard)]
    ]
    holds_shards = any(folder.glob("shard-*.h5"))
    if not (folder / DATASET_FILE).exists():
        if holds_shards:
            raise InputError(f"{folder}: holds shards but no {DATASET_FILE}; choose another folder with -o.")
        with contextlib.suppress(FileExistsError, FileNotFoundError):  # others, who started at the same moment, did
            write_dataset_file(folder, header, entries)
    document = read_dataset_file(folder)
    difference = first_difference(identity(document.get("config"), document.get("object")), own_identity(job))
    rest = {"camera": header.camera.to_json(), "depth_unit": header.depth_unit, "seed": header.seed, "shards": entries}
    difference = difference or first_difference({name: document.get(name) for name in rest}, rest)
    if difference is not None:
        raise InputError(
            f"{folder}: holds another dataset ({difference}); choose another folder with -o, "
            "or repeat the command that this one was built with."
        )


def _missing_shards(folder: Path, job: Job, shards: range, report: BuildReport) -> list[int]:
    missing, own = [], own_identity(job)
    for shard in shards:
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


@contextlib.contextmanager
def _no_leftovers(folder: Path, shards: range) -> Iterator[None]:
    """Remove, before and after, what killed builds of these shards were writing: nobody else is at work on them."""
    _remove_leftovers(folder, shards)
    try:
        yield
    finally:
        _remove_leftovers(folder, shards)


def _remove_leftovers(folder: Path, shards: range) -> None:
    names = [DATASET_FILE] * (len(shards) > 0)  # which is there, so that nobody needs another
    names += [shard_name(shard) for shard in shards]
    for leftover in folder.glob(".*.tmp"):
        if any(leftover.name.startswith(f".{name}.") for name in names):
            leftover.unlink(missing_ok=True)


def _scenes(job: Job, shards: Iterable[int]) -> int:
    return sum(len(job.config.scenes_of_shard(shard)) for shard in shards)


def _compile(job: Job) -> None:
    """Render one instance here, so that the workers find the compiled code instead of each compiling it."""
    camera = draw_viewpoints(job.config.viewpoints, job.config.camera, job.bin, job.model.diameter, 0, 0, 1)
    for _ in SceneRenderer(job).views(Scene(0, np.eye(4)[None], camera)):
        pass


def _pool(workers: int, dask: str | None, folder: Path) -> AbstractContextManager[Pool]:
    if dask is None:
        return contextlib.nullcontext(processes_here(workers))
    from simgen.workers.dask import dask_cluster

    return dask_cluster(dask, folder)


def _build_shards(
    job: Job, folder: Path, shards: list[int], pool: Pool, report: BuildReport, progress: SceneProgress
) -> None:
    def submit(executor: Executor, shard: int) -> Future[ShardReport]:
        return executor.submit(build_shard, job.for_shard(shard), folder.absolute(), shard)

    report.broken_pools = run_tasks(pool, shards, submit, report.written.append, progress)
