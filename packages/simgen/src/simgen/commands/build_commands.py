"""`simgen build`, and its two stages by themselves: `simgen simulate`, `simgen render`."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from evalkit.commands.command import Command
from evalkit.commands.group import suggest_next
from evalkit.commands.output_file import OutputFile
from evalkit.errors import InputError
from simgen.commands.options import (
    ObjectChoice,
    camera_options,
    configured,
    dask_option,
    distances_in_meters,
    like_option,
    object_options,
    pile_options,
    shard_options,
    some_shards_option,
    workers_option,
)
from simgen.commands.parsing import parse_shards
from simgen.config import BuildConfig
from simgen.physics.engines import require_engine
from simgen.presets import PRESETS
from simgen.rendering.gl_platform import require_gl

if TYPE_CHECKING:
    from simgen.scenes.job import Job


@click.command("build", cls=Command)
@object_options
@like_option
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("shards"), show_default=True)
@pile_options
@camera_options
@shard_options
@workers_option
@some_shards_option
@dask_option
def build_command(
    chosen: ObjectChoice | None,
    like: Path | None,
    output: Path,
    preset: str,
    workers: int,
    shards: str | None,
    dask: str | None,
    **options: Any,
) -> None:
    """Simulate piles of an object, render them, and write labeled depth images as shards.

    Run the same command again to complete a folder that was interrupted. Options override the preset's values.

    Several machines may fill one folder that all of them see, each with --shards of its own. As a Slurm array of
    twenty jobs: sbatch --array=0-19 --wrap 'simgen build … -o shards --shards
    $((10 * SLURM_ARRAY_TASK_ID))-$((10 * SLURM_ARRAY_TASK_ID + 9))'

    A Dask cluster is given by its scheduler: --dask tcp://HOST:8786. Its workers need the folder under the same path,
    the same software, and one thread each: dask worker tcp://HOST:8786 --nthreads 1 --nworkers 16
    """
    if like is not None:
        job = _planned_like(like, chosen, options)
    else:
        assert chosen is not None  # the options see to it
        config = configured(PRESETS[preset](), **options)
        _require_installed(config)
        job = _planned(config, chosen, options)
    _write_shards(job, output, workers, shards, dask)
    if shards is None:
        _say_next(output, job, is_test=like is not None)


@click.command("simulate", cls=Command)
@object_options
@click.option("-o", "--output", type=OutputFile(".h5", ".hdf5"), default=Path("scenes.h5"), show_default=True)
@pile_options
@camera_options
@shard_options
@workers_option
def simulate_command(
    chosen: ObjectChoice,
    output: Path,
    preset: str,
    workers: int,
    **options: Any,
) -> None:
    """Simulate piles of an object and write their poses, without any image, as one small file.

    `simgen render` makes of it what `simgen build` with the same options writes, on any machine, PyBullet or not.
    Run the same command again to go on with a file that was interrupted.
    """
    from simgen.building.scenes_file import simulate

    config = configured(PRESETS[preset](), **options)
    require_engine(config.physics.engine)
    job = _planned(config, chosen, options)
    start = time.monotonic()
    report = simulate(job, output, workers)
    _warn_of_broken_pools(report.broken_pools)
    click.echo(
        f"{output}: {report.simulated} scenes simulated in {time.monotonic() - start:.0f} s, {report.kept} kept, "
        f"{report.redone} drops redone, {output.stat().st_size / 1e6:.2g} MB"
    )


@click.command("render", cls=Command)
@click.argument("scenes", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("shards"), show_default=True)
@camera_options
@shard_options
@workers_option
@some_shards_option
@dask_option
def render_command(
    scenes: Path, output: Path, workers: int, shards: str | None, dask: str | None, **options: Any
) -> None:
    """Render SCENES and write labeled depth images as shards. Needs no PyBullet.

    SCENES is a file of `simgen simulate`: without options the shards are, byte for byte, those of `simgen build`;
    options put others in place of what `simgen simulate` was given.

    Or a folder as the Siléane dataset has them, with gt/, camera_params.txt, poseutils.json and mesh.obj: the scenes
    in gt/ as that camera sees them, on the ground and without walls, in the order of their names.
    """
    job = _rendered_layouts(scenes, options) if scenes.is_dir() else _rendered_scenes(scenes, options)
    _require_renderer(job.config)
    _write_shards(job, output, workers, shards, dask)


def _rendered_scenes(path: Path, options: dict[str, Any]) -> Job:
    from simgen.scenes.file import job_of_scenes
    from simgen.scenes.plan import plan

    job = job_of_scenes(path)
    distances = distances_in_meters(options["distance"])
    job = plan(configured(job.config, **options), job.model, job.convex_parts, job.recorded, distances)
    _print_settings(job)
    return job


def _rendered_layouts(folder: Path, options: dict[str, Any]) -> Job:
    from simgen.scenes.layouts import job_of_layouts, nearest_and_farthest, with_options

    if distances_in_meters(options["distance"]) is not None:
        raise InputError(f"{folder}: says where its camera stands; leave out --distance.")
    job = job_of_layouts(folder)
    config = configured(job.config, **options)
    job = with_options(job, config)
    click.echo(
        f"{folder}: {config.scenes} scenes of {config.instances_min} to {config.instances_max} instances of "
        f"'{job.model.title}', {config.camera.width} x {config.camera.height} pixels, depth unit {job.depth_unit:g} m."
    )
    if config.sensor is not None:
        click.echo(config.sensor.describe(config.camera, *nearest_and_farthest(job)))
    return job


def _planned(config: BuildConfig, chosen: ObjectChoice, options: dict[str, Any]) -> Job:
    """The job of an object and a config, printed for the user."""
    from simgen.objects.prepare import prepare_object
    from simgen.scenes.plan import plan

    prepared = prepare_object(**asdict(chosen))
    for warning in prepared.warnings:
        click.echo(f"Warning: {warning}", err=True)
    job = plan(config, prepared.model, prepared.convex_parts, distances=distances_in_meters(options["distance"]))
    click.echo(prepared.summary)
    _print_settings(job)
    return job


def _planned_like(like: Path, chosen: ObjectChoice | None, options: dict[str, Any]) -> Job:
    """The job of other scenes than those of the shards `like`, which give the object and all other values.

    Raises:
        InputError: an object or a preset is given too, or the scenes would be the same.
    """
    from simgen.building.repair import job_of_dataset
    from simgen.scenes.plan import plan

    context = click.get_current_context()
    if chosen is not None or context.get_parameter_source("preset") is not ParameterSource.DEFAULT:
        raise InputError("--like: gives object and values; leave --object and --preset out.")
    known, _ = job_of_dataset(like)
    config = configured(known.config, **options)
    if config.seed == known.config.seed:
        raise InputError(
            f"--like {like}: with seed {config.seed} its scenes would be drawn again; give another --seed."
        )
    _require_installed(config)
    job = plan(config, known.model, known.convex_parts, distances=distances_in_meters(options["distance"]))
    _print_settings(job)
    return job


def _say_next(output: Path, job: Job, is_test: bool) -> None:
    if is_test:
        run = next(iter(sorted(Path("runs").glob(f"{job.model.name or 'object'}-*"))), "MODEL")
        suggest_next("posenet", "predict", run, output, "--refine", "-o", "preds.json")
    else:
        suggest_next("posenet", "fit", output)


def _require_installed(config: BuildConfig) -> None:
    """Raise InputError unless the config's physics engine is there, and what its renderer needs."""
    require_engine(config.physics.engine)
    _require_renderer(config)


def _require_renderer(config: BuildConfig) -> None:
    if config.renderer == "pyrender":
        require_gl()


def _print_settings(job: Job) -> None:
    from simgen.scenes.plan import camera_distances

    click.echo(job.config.describe())
    click.echo(f"Depth unit: {job.depth_unit:g} m.")
    if job.config.sensor is not None:
        click.echo(job.config.sensor.describe(job.config.camera, *camera_distances(job)))


def _write_shards(job: Job, output: Path, workers: int, shards: str | None, dask: str | None) -> None:
    from simgen.building.build import build

    some = None if shards is None else parse_shards(shards, job.config.shards)
    start = time.monotonic()
    report = build(job, output, workers, some, dask)
    seconds = time.monotonic() - start
    for name in report.damaged:
        click.echo(f"Warning: {name} was damaged and has been rebuilt.", err=True)
    _warn_of_broken_pools(report.broken_pools)
    written = sum(shard.scenes for shard in report.written)
    part = "" if some is None else f"shards {some.start} to {some.stop - 1} of {job.config.shards}, "
    click.echo(
        f"{output}: {part}{written} scenes ({written * job.config.views} frames) written in {seconds:.0f} s, "
        f"{report.kept} shards kept, {report.redone} drops redone"
    )


def _warn_of_broken_pools(broken_pools: int) -> None:
    if broken_pools:
        click.echo(f"Warning: workers were killed {broken_pools} times; their shards were redone.", err=True)
