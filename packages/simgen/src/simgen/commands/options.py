"""Options that several commands share, in groups, and the config that they come to."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.meshes.units import CHOICES
from simgen.commands.parsing import parse_bin, parse_instances, parse_range
from simgen.config import RENDERERS, BuildConfig
from simgen.config_sections import DistractorConfig
from simgen.presets import PHYSICS, PRESETS, default_camera
from simgen.rendering.measured_table import read_table
from simgen.sensors.sensor_text import parse_sensor

MOST_METERS = 50.0  # farther off is no camera of bins; millimeters would be
DEFAULT_SHARE = 0.3  # of distractors
Command = TypeVar("Command", bound=Callable[..., Any])


def _group(*options: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Several options as one decorator, in the order in which --help shows them."""

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@dataclass(frozen=True)
class ObjectChoice:
    """Which object, and how its file is to be read: the arguments of :func:`simgen.objects.prepare.prepare_object`."""

    source: str
    units: str
    scale: float
    symmetry: str
    name: str | None


def object_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that choose an object, which reach the command as one `chosen`; None where --like chooses it."""

    @wraps(command)
    def choosing(*, source: str | None, units: str, scale: float, symmetry: str, name: str | None, **rest: Any) -> Any:
        if source is None and rest.get("like") is None:
            raise InputError(
                "Missing --object: give a mesh file (PLY, STL, OBJ …), or bunny, gear, cup … to try it out."
            )
        chosen = None if source is None else ObjectChoice(source, units, scale, symmetry, name)
        return command(chosen=chosen, **rest)

    return _OBJECT_OPTIONS(choosing)


_OBJECT_OPTIONS = _group(
    click.option(
        "--object",
        "source",
        metavar="FILE|NAME",
        help="Mesh file, or bunny, cup, candlestick, pepper, gear, brick, connector or bracket.",
    ),
    click.option("--units", type=click.Choice(CHOICES), default="auto", show_default=True),
    click.option("--scale", type=float, default=1.0, show_default=True, help="Factor on the object's size."),
    click.option(
        "--symmetry", default="auto", show_default=True, help="auto, none, cyclic:N, dihedral:N, revolution …"
    ),
    click.option("--name", help="What documents call the object.  [default: its file's name]"),
)
pile_options = _group(
    click.option(
        "--preset",
        type=click.Choice(list(PRESETS)),
        default="default",
        show_default=True,
        help="default: 1,000 scenes of 17 views, enough for an hour on two cores; paper: 2,000, as published.",
    ),
    click.option("--scenes", type=int, help="Piles to simulate."),
    click.option("--instances", metavar="MIN-MAX", help="Instances a scene."),
    click.option("--seed", type=int),
    click.option("--physics", type=click.Choice(list(PHYSICS)), help="Engine; rapier is an extra of simgen."),
    click.option("--bin", "bin_text", metavar="auto|WxDxH", help="Inner size of the bin in meters."),
    click.option("--bin-jitter", type=float, help="A scene's bin differs from the dataset's by up to this share."),
    click.option(
        "--walls", type=float, help="Share of the scenes whose bin has walls; in the others they are lifted off."
    ),
    click.option(
        "--distractors",
        metavar="FILES|builtin",
        help="Foreign things among the parts, without labels: mesh files with commas between, or other parts, packing, "
        "a finger and cables; none leaves them out.",
    ),
    click.option("--share", type=float, help="Distractors' share of all that lies in a scene.  [default: 0.3]"),
)
camera_options = _group(
    click.option("--views", type=int, help="Cameras a scene."),
    click.option("--width", type=int, help="Image width in pixels."),
    click.option("--height", type=int, help="Image height in pixels."),
    click.option(
        "--camera",
        "camera_file",
        type=click.Path(path_type=Path),
        help="Camera file of ours, BOP, ROS, OpenCV, RealSense …; 'evalkit camera FILE' shows what is understood.",
    ),
    click.option("--tilt", metavar="MIN-MAX", help="Of the optical axis from the vertical, in degrees."),
    click.option(
        "--distance",
        metavar="MIN-MAX",
        help="Meters from the bin's floor; as MIN-MAXx, multiples of that from which the bin fits.",
    ),
    click.option(
        "--table",
        "table",
        metavar="A,B,C,D|FILE",
        help="Measured table in place of tilt and distance: its plane A·x + B·y + C·z = D before the camera in meters, "
        "or a JSON file with plane, cam_from_table or table_from_cam.",
    ),
    click.option(
        "--look-at-jitter", type=float, help="The point looked at is up to this share of the bin off its middle."
    ),
    click.option(
        "--sensor",
        "sensor_text",
        metavar="ideal|stereo|kinect|FILE",
        help="Depth camera, or a file of 'simgen sensor fit'; surfaces (shiny, dark, translucent) and parameters "
        "follow: stereo,shiny,baseline=0.1.",
    ),
    click.option("--keep-ideal", is_flag=True, default=None, help="Store the depth without the sensor's errors too."),
    click.option(
        "--renderer", type=click.Choice(RENDERERS), help="What draws: ours on the CPU, or OpenGL; same labels."
    ),
)
shard_options = _group(
    click.option("--compression", help="zstd or gzip."),
    click.option("--shard-scenes", type=int, help="Scenes a shard file."),
)
workers_option = click.option(
    "--workers",
    type=int,
    callback=lambda _context, _option, value: _workers(value),
    help="Processes; all CPU cores if not given. Does not change the result.",
)
like_option = click.option(
    "--like",
    type=click.Path(path_type=Path),
    metavar="SHARDS",
    help="Object and every value of these shards, in place of --object and --preset: a test set, with another --seed.",
)
some_shards_option = click.option(
    "--shards", metavar="FIRST-LAST", help="Build only these shards of the folder, counted from 0."
)
dask_option = click.option(
    "--dask", metavar="ADDRESS", help="Compute on the Dask cluster of this scheduler, as tcp://host:8786."
)


def _workers(value: int | None) -> int:
    if value is not None and value < 1:
        raise InputError(f"--workers {value}: must be 1 or more.")
    return len(os.sched_getaffinity(0)) if value is None else value


def distances_in_meters(distance: str | None) -> tuple[float, float] | None:
    """What --distance says in meters; None where it is not given, or says multiples (1-1.5x), which the config holds.

    Raises:
        InputError: it is no range of positive numbers.
    """
    if distance is None or distance.endswith("x"):
        return None
    nearest, farthest = parse_range("--distance", distance)
    if nearest <= 0 or farthest > MOST_METERS:
        raise InputError(
            f"--distance {distance}: must be meters from the bin's floor, above 0 and at most {MOST_METERS:g}, as in "
            "0.4-0.6."
        )
    return nearest, farthest


def configured(
    preset: BuildConfig,
    instances: str | None = None,
    bin_text: str | None = None,
    width: int | None = None,
    height: int | None = None,
    camera_file: Path | None = None,
    tilt: str | None = None,
    distance: str | None = None,
    table: str | None = None,
    look_at_jitter: float | None = None,
    bin_jitter: float | None = None,
    walls: float | None = None,
    sensor_text: str | None = None,
    distractors: str | None = None,
    share: float | None = None,
    physics: str | None = None,
    **numbers: Any,
) -> BuildConfig:
    """The preset, or another config, with the options that were given in place of its values.

    Raises:
        InputError: an option makes no sense; the sentence names it.
    """
    changes = {name: value for name, value in numbers.items() if value is not None}
    if instances is not None:
        changes["instances_min"], changes["instances_max"] = parse_instances(instances)
    if bin_text is not None:
        changes["bin"] = parse_bin(bin_text)
    if distractors is not None or share is not None:
        changes["distractors"] = _distractors(preset.distractors, distractors, share)
    if physics is not None:
        changes["physics"] = PHYSICS[physics]()
    if sensor_text is not None:
        changes["sensor"] = parse_sensor(sensor_text)
    if camera_file is not None:
        changes["camera"] = _camera(camera_file, width, height)
    elif width is not None or height is not None:
        sides = (preset.camera.width if width is None else width, preset.camera.height if height is None else height)
        changes["camera"] = default_camera(*sides)
    views: dict[str, Any] = {} if look_at_jitter is None else {"look_at_jitter": look_at_jitter}
    if table is not None:
        if tilt is not None or distance is not None:
            raise InputError(
                "--table: says how the camera is tilted and how far it is; leave --tilt and --distance out."
            )
        pose, views["max_turn_degrees"] = read_table(table, changes.get("camera", preset.camera))
        views["cam_from_table"] = tuple(tuple(row) for row in pose.tolist())
    elif tilt is not None or distance is not None:
        views["cam_from_table"] = None
    if tilt is not None:
        views["min_tilt_degrees"], views["max_tilt_degrees"] = parse_range("--tilt", tilt)
    if distance is not None and distance.endswith("x"):
        views["nearest"], views["farthest"] = parse_range("--distance", distance.removesuffix("x"))
    given = {"bin_jitter": bin_jitter, "wall_probability": walls}
    pile: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    changes["viewpoints"], changes["pile"] = replace(preset.viewpoints, **views), replace(preset.pile, **pile)
    return replace(preset, **changes)


def _camera(path: Path, width: int | None, height: int | None) -> Camera:
    """The camera of a file; its size is --width x --height where the file does not say one."""
    given = (width, height) if width is not None and height is not None else None
    camera = Camera.load(path, None if given is None else lambda: given)
    if (width, height) != (None, None) and given != (camera.width, camera.height):
        raise InputError(
            f"--camera {path}: the file gives the image's size, {camera.width} x {camera.height}; leave --width and "
            "--height out."
        )
    return camera


def _distractors(known: DistractorConfig | None, text: str | None, share: float | None) -> DistractorConfig | None:
    """The config's distractors with what the options say."""
    from simgen.objects.foreign_things import parse_distractors  # only here: it brings trimesh

    if text == "none":
        if share is not None:
            raise InputError(f"--share {share:g}: of no distractors; leave one of both options out.")
        return None
    if text is not None:
        return parse_distractors(text, (DEFAULT_SHARE if known is None else known.share) if share is None else share)
    if known is None:
        raise InputError(f"--share {share:g}: of which distractors? Give --distractors builtin, or mesh files, too.")
    return known if share is None else replace(known, share=share)
