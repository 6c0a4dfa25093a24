"""From a job to a folder of shards: in parallel, resumable, and with the same bytes every time.

A shard is one task: simulated, rendered and written by one process. Nothing that a task computes depends on another,
so that workers, order and interruptions do not show in the result.
"""

from __future__ import annotations

import contextlib
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from evalkit.datasets.shard_folder import shard_name
from evalkit.datasets.shard_writer import ShardWriter
from simgen.building.dataset_folder import claim, no_leftovers, require_own_schema, unfinished
from simgen.building.shard_locks import shards_locked
from simgen.scenes.job import Job
from simgen.scenes.render import SceneRenderer, compile_renderer
from simgen.scenes.simulate import make_scene
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
        InputError: the folder holds another dataset, or one begun with an old schema that is incomplete, another build
            is at work in it, or workers keep dying.
        OSError: the folder cannot be written.
    """
    claim(folder, job)
    shards = range(job.config.shards) if shards is None else shards
    with shards_locked(folder, shards) as alone, no_leftovers(folder, shards if alone else range(0)):
        missing, damaged = unfinished(folder, job, shards)
        wanted = sorted(missing + damaged)
        report = BuildReport(len(shards) - len(wanted), [shard_name(shard) for shard in damaged])
        if wanted:
            require_own_schema(folder)
            compile_renderer(job)
            scenes = sum(len(job.config.scenes_of_shard(shard)) for shard in wanted)
            with _pool(workers, dask, folder, job.config.physics.engine) as pool, SceneProgress(scenes) as progress:
                _build_shards(job, folder, wanted, pool, report, progress)
    return report


def _build_shards(
    job: Job, folder: Path, shards: list[int], pool: Pool, report: BuildReport, progress: SceneProgress
) -> None:
    def submit(executor: Executor, shard: int) -> Future[ShardReport]:
        return executor.submit(build_shard, job.for_shard(shard), folder.absolute(), shard)

    report.broken_pools = run_tasks(pool, shards, submit, report.written.append, progress)


def build_shard(job: Job, folder: Path, shard: int) -> ShardReport:
    """Simulate, render and write one shard; the unit of work that a local process or a cluster's worker gets."""
    numbers, redone = job.config.scenes_of_shard(shard), 0
    frames, ideal = len(numbers) * job.config.views, job.config.keep_ideal
    renderer = SceneRenderer(job)
    with ShardWriter(folder / shard_name(shard), job.header, frames, job.config.compression, ideal) as writer:
        for number in numbers:
            scene, attempts = make_scene(job, number)
            for view in renderer.views(scene):
                writer.append(view)
            redone += attempts - 1
            count_scene(attempts - 1)
    return ShardReport(shard, len(numbers), redone)


def _pool(workers: int, dask: str | None, folder: Path, engine: str) -> AbstractContextManager[Pool]:
    if dask is None:
        return contextlib.nullcontext(processes_here(workers))
    from simgen.workers.dask import dask_cluster

    return dask_cluster(dask, folder, engine)
