"""The options of commands that read depth images: which camera took them, and what their values mean."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evalkit.commands.group import show_notes
from evalkit.errors import InputError

if TYPE_CHECKING:
    from evalkit.depth.sources import DepthSource

FILE = click.Path(path_type=Path)
IMAGE_OPTIONS = [
    click.option(
        "--camera",
        "camera_file",
        type=FILE,
        help="Of image files: ours, BOP, ROS, OpenCV, RealSense …, or FILE#NAME; see 'evalkit camera FILE'.",
    ),
    click.option("--rectified", is_flag=True, help="The images were rectified: no lens, and P of a camera_info."),
    click.option("--depth-unit", type=click.FloatRange(min=0, min_open=True), help="Meters a step, e.g. 0.001."),
    click.option("--no-return", type=float, help="Stored value that means no return.  [default: saturated ones]"),
    click.option(
        "--depth-along",
        type=click.Choice(["axis", "ray"]),
        default="axis",
        show_default=True,
        help="What depth measures.",
    ),
    click.option("--rotate", type=click.Choice(["90", "180", "270"]), help="Turn images clockwise to be the camera's."),
    click.option("--targets", type=FILE, help="Of a BOP dataset: test_targets_bop19.json."),
    click.option("--sensor", help="Of a BOP dataset with several sensors, this one, such as cam1."),
]
NAMES = ("camera_file", "rectified", "depth_unit", "no_return", "depth_along", "rotate", "targets", "sensor")


def image_options(command: Any) -> Any:
    """Every option that says how depth images are to be read."""
    for option in reversed(IMAGE_OPTIONS):
        command = option(command)
    return command


def opened(source: Path | None, options: dict[str, Any], purpose: str) -> DepthSource:
    """The depth images at `source`; takes :func:`image_options` out of a command's `options`.

    Args:
        purpose: what the images are for, to end a sentence.

    Raises:
        InputError: no source is given, or nothing usable lies there.
    """
    from evalkit.depth.images import Reading
    from evalkit.depth.sources import SOURCES, open_source

    chosen = {name: options.pop(name) for name in NAMES}
    if source is None:
        raise InputError(f"Missing SOURCE, the images {purpose}: give {SOURCES}.")
    no_return, along, rotate = (chosen.pop(name) for name in ("no_return", "depth_along", "rotate"))
    reading = Reading(no_return=no_return, along_ray=along == "ray", turned=int(rotate or 0))
    show_notes("evalkit.depth")
    found = open_source(source, reading=reading, **chosen)
    for remark in found.remarks:
        click.echo(f"Note: {remark}", err=True)
    return found


def as_typed(options: dict[str, Any]) -> list[str]:
    """Those of :func:`image_options` that were given, as words of the next command."""
    names = {"camera_file": "--camera"}
    given = {name: options[name] for name in NAMES if options[name] not in (None, False, "axis")}
    words = ([names.get(name, "--" + name.replace("_", "-")), str(value)] for name, value in given.items())
    return [word for pair in words for word in pair if word != "True"]
