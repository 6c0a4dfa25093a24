"""Physics alone: from a job to a small file of poses, which renders to the shards that a build would have written."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path

from evalkit.errors import InputError
from simgen.scenes.file import read_scenes, write_scenes
from simgen.scenes.identity import first_difference, identity_of
from simgen.scenes.job import Job
from simgen.scenes.journal import SUFFIX, SceneJournal, SimulatedScenes, scene_journal
from simgen.scenes.simulate import simulate_poses
from simgen.workers.local import count_scene, processes_here
from simgen.workers.progress import SceneProgress
from simgen.workers.tasks import run_tasks


@dataclass
class SimulationReport:
    """Scenes that were there already, and simulated now; drops redone; pools that broke."""

    kept: int = 0
    simulated: int = 0
    redone: int = 0
    broken_pools: int = 0


def simulate(job: Job, path: Path, workers: int) -> SimulationReport:
    """Write the scenes file of a job; what an interrupted run left beside it is taken up.

    Raises:
        InputError: the file holds something else, somebody is at work on it, or workers keep dying.
        OSError: the file cannot be written.
    """
    if path.exists():
        _require_same(job, path)
        return SimulationReport(kept=job.config.scenes)
    with scene_journal(path, job.identity) as journal:
        report = SimulationReport(kept=sum(done.scenes for done in journal.finished.values()))
        missing = sorted(set(range(job.config.shards)) - set(journal.finished))
        if missing:
            _simulate(job, missing, workers, journal, report)
        done = [journal.finished[task] for task in range(job.config.shards)]
        scenes = [scene for part in done for scene in part.world_from_obj]
        write_scenes(path, job.header, scenes, [count for part in done for count in part.attempts])
        path.with_name(path.name + SUFFIX).unlink()
    return report


def simulate_scenes(job: Job, task: int) -> SimulatedScenes:
    """The scenes of a shard; the unit of work that a worker gets."""
    done = SimulatedScenes(task, [], [])
    for number in job.config.scenes_of_shard(task):
        world_from_obj, attempts = simulate_poses(job, number)
        done.world_from_obj.append(world_from_obj)
        done.attempts.append(attempts)
        count_scene(attempts - 1)
    return done


def _simulate(job: Job, tasks: list[int], workers: int, journal: SceneJournal, report: SimulationReport) -> None:
    def submit(executor: Executor, task: int) -> Future[SimulatedScenes]:
        return executor.submit(simulate_scenes, job, task)

    def keep(done: SimulatedScenes) -> None:
        journal.append(done)
        report.simulated += done.scenes
        report.redone += done.redone

    with SceneProgress(sum(len(job.config.scenes_of_shard(task)) for task in tasks)) as progress:
        report.broken_pools = run_tasks(processes_here(workers), tasks, submit, keep, progress)


def _require_same(job: Job, path: Path) -> None:
    header, _ = read_scenes(path)
    difference = first_difference(identity_of(header), job.identity)
    if difference is not None:
        raise InputError(f"{path}: holds other scenes ({difference}); choose another file with -o.")
