"""The `simgen` command."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from evalkit.camera import Camera
from evalkit.command import Commands
from evalkit.errors import InputError
from simgen.config import PRESETS, RENDERERS, BuildConfig, default_camera, parse_bin, parse_instances, parse_range
from simgen.export_commands import export_command
from simgen.gl_platform import require_gl
from simgen.inspect_commands import object_command, preview_command, verify_command
from simgen.sensor_config import parse_sensor


@click.group(cls=Commands)
@click.version_option(package_name="binpose-simgen")
def cli() -> None:
    """From a CAD mesh to labelled bin-picking depth images."""


@cli.command("build")
@click.option(
    "--object",
    "source",
    required=True,
    metavar="FILE|NAME",
    help="Mesh file, or bunny, cup, candlestick, pepper, gear, brick, connector or bracket.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("shards"), show_default=True)
@click.option("--preset", type=click.Choice(list(PRESETS)), default="default", show_default=True)
@click.option("--scenes", type=int, help="Piles to simulate.")
@click.option("--views", type=int, help="Cameras a scene.")
@click.option("--instances", metavar="MIN-MAX", help="Instances a scene.")
@click.option("--seed", type=int)
@click.option("--workers", type=int, help="Processes; all CPU cores if not given. Does not change the result.")
@click.option("--width", type=int, help="Image width in pixels.")
@click.option("--height", type=int, help="Image height in pixels.")
@click.option(
    "--camera",
    "camera_file",
    type=click.Path(path_type=Path),
    help="Our JSON, a BOP camera.json, or a ROS camera_info as YAML.",
)
@click.option("--units", type=click.Choice(["auto", "m", "mm"]), default="auto", show_default=True)
@click.option("--scale", type=float, default=1.0, show_default=True, help="Factor on the object's size.")
@click.option("--symmetry", default="auto", show_default=True, help="auto, none, cyclic:N, dihedral:N, revolution …")
@click.option("--bin", "bin_text", metavar="auto|WxDxH", help="Inner size of the bin in metres.")
@click.option("--tilt", metavar="MIN-MAX", help="Of the optical axis from the vertical, in degrees.")
@click.option("--distance", metavar="MIN-MAX", help="Multiples of that from which the bin just fits the image.")
@click.option("--look-at-jitter", type=float, help="The point looked at is up to this share of the bin off its middle.")
@click.option("--bin-jitter", type=float, help="A scene's bin differs from the dataset's by up to this share.")
@click.option("--walls", type=float, help="Share of the scenes whose bin has walls; in the others they are lifted off.")
@click.option(
    "--sensor",
    "sensor_text",
    metavar="ideal|stereo|kinect",
    help="Depth camera; parameters follow: stereo,baseline=0.1.",
)
@click.option("--keep-ideal", is_flag=True, default=None, help="Store the depth without the sensor's errors too.")
@click.option("--renderer", type=click.Choice(RENDERERS), help="What draws: ours on the CPU, or OpenGL; same labels.")
@click.option("--compression", help="zstd or gzip.")
@click.option("--shard-scenes", type=int, help="Scenes a shard file.")
def build_command(
    source: str, output: Path, preset: str, workers: int | None, units: str, scale: float, symmetry: str, **options: Any
) -> None:
    """Simulate piles of an object, render them, and write labelled depth images as shards.

    Run the same command again to complete a folder that was interrupted. Options override the preset's values.
    """
    config = _configured(PRESETS[preset](), **options)
    workers = len(os.sched_getaffinity(0)) if workers is None else workers
    if workers < 1:
        raise InputError(f"--workers {workers}: must be 1 or more.")
    if config.renderer == "pyrender":
        require_gl()
    from simgen.build import build  # here, for --help need not wait for numba and PyBullet
    from simgen.meshes import prepare_object
    from simgen.scenes import camera_distances, plan

    prepared = prepare_object(source, units=units, scale=scale, symmetry=symmetry)
    for warning in prepared.warnings:
        click.echo(f"Warning: {warning}", err=True)
    job = plan(config, prepared.model, prepared.convex_parts)
    click.echo(prepared.summary)
    click.echo(job.config.describe())
    click.echo(f"Depth unit: {job.depth_unit:g} m.")
    if config.sensor is not None:
        click.echo(config.sensor.describe(config.camera, *camera_distances(job)))
    start = time.monotonic()
    report = build(job, output, workers)
    seconds = time.monotonic() - start
    for name in report.damaged:
        click.echo(f"Warning: {name} was damaged and has been rebuilt.", err=True)
    if report.broken_pools:
        click.echo(f"Warning: workers were killed {report.broken_pools} times; their shards were redone.", err=True)
    written = sum(shard.scenes for shard in report.written)
    click.echo(
        f"{output}: {written} scenes ({written * config.views} frames) written in {seconds:.0f} s, "
        f"{report.kept} shards kept, {report.redone} drops redone"
    )


def _configured(
    preset: BuildConfig,
    instances: str | None,
    bin_text: str | None,
    width: int | None,
    height: int | None,
    camera_file: Path | None,
    tilt: str | None,
    distance: str | None,
    look_at_jitter: float | None,
    bin_jitter: float | None,
    walls: float | None,
    sensor_text: str | None,
    **numbers: Any,
) -> BuildConfig:
    """The preset with the options that were given in place of its values."""
    changes = {name: value for name, value in numbers.items() if value is not None}
    if instances is not None:
        changes["instances_min"], changes["instances_max"] = parse_instances(instances)
    if bin_text is not None:
        changes["bin"] = parse_bin(bin_text)
    if sensor_text is not None:
        changes["sensor"] = parse_sensor(sensor_text)
    if camera_file is not None:
        if width is not None or height is not None:
            raise InputError("--camera: the file gives the image's size; leave --width and --height out.")
        changes["camera"] = Camera.load(camera_file)
    elif width is not None or height is not None:
        sides = (preset.camera.width if width is None else width, preset.camera.height if height is None else height)
        changes["camera"] = default_camera(*sides)
    views: dict[str, Any] = {} if look_at_jitter is None else {"look_at_jitter": look_at_jitter}
    if tilt is not None:
        views["min_tilt_degrees"], views["max_tilt_degrees"] = parse_range("--tilt", tilt)
    if distance is not None:
        views["nearest"], views["farthest"] = parse_range("--distance", distance)
    given = {"bin_jitter": bin_jitter, "wall_probability": walls}
    pile: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    changes["viewpoints"], changes["pile"] = replace(preset.viewpoints, **views), replace(preset.pile, **pile)
    return replace(preset, **changes)


cli.add_command(export_command)
cli.add_command(object_command)
cli.add_command(preview_command)
cli.add_command(verify_command)


def main() -> None:
    """Entry point of the `simgen` command."""
    cli()
