"""`evalkit camera`: what is understood of a camera file."""

from __future__ import annotations

import json
import math
from pathlib import Path

import click

from evalkit.commands.command import Command
from evalkit.commands.output_file import DOCUMENTS, OutputFile
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_files import CameraFile, read_camera


@click.command(cls=Command)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--at", "distance", type=click.FloatRange(min=0, min_open=True), help="Also what it sees there, meters.")
@click.option("--rectified", is_flag=True, help="Of rectified images: a camera_info's projection matrix P.")
@click.option("-o", "--output", type=OutputFile(*DOCUMENTS), help="Write the pinhole camera as our JSON.")
@click.option("--json", "as_json", is_flag=True, help="Print the pinhole camera as our JSON, and nothing else.")
def camera(file: Path, distance: float | None, rectified: bool, output: Path | None, as_json: bool) -> None:
    """Print what is understood of a camera FILE: size, focal lengths, lens, field of view, millimeters a pixel.

    FILE may be of ours, BOP, ROS, OpenCV, RealSense, Orbbec, Open3D, Zivid, Kalibr, COLMAP, MATLAB, Siléane …; of
    several cameras in it, FILE#NAME is one, such as calibration.json#depth.
    """
    found = read_camera(file, rectified)
    for remark in found.remarks:
        click.echo(f"Note: {remark}", err=True)
    click.echo(json.dumps(found.camera.to_json(), indent=1) if as_json else describe(file, found, distance))
    if output is not None:
        from evalkit.atomic import write_json

        write_json(output, found.camera.to_json(), indent=1)
        click.echo(f"{output} written", err=True)


def describe(file: Path, found: CameraFile, distance: float | None) -> str:
    """A camera in lines that a person reads."""
    camera = found.camera
    across, down = (_degrees(*side) for side in _sides(camera))
    lines = [
        f"camera         {file}",
        f"image          {camera.width} x {camera.height} pixels",
        f"focal lengths  fx {camera.fx:.6g}, fy {camera.fy:.6g} pixels",
        f"center         cx {camera.cx:.6g}, cy {camera.cy:.6g}, counted from the middle of the first pixel",
        f"lens           {_lens(found)}",
        f"field of view  {across:.1f} x {down:.1f} degrees",
    ]
    if found.depth_unit is not None:
        lines.append(f"depth unit     {found.depth_unit:g} m a step")
    if distance is not None:
        width, height = (distance * size / focal for size, focal in _extents(camera))
        per_pixel = 1e3 * distance / camera.fx
        lines.append(f"at {distance:g} m".ljust(15) + f"{width:.3g} x {height:.3g} m seen, {per_pixel:.3g} mm a pixel")
    return "\n".join(lines)


def _lens(found: CameraFile) -> str:
    if found.lens is None:
        return "none: images are the pinhole camera's"
    return f"{found.lens.describe()}; 'posenet predict' rectifies depth images before it looks at them"


def _extents(camera: Camera) -> tuple[tuple[int, float], tuple[int, float]]:
    return (camera.width, camera.fx), (camera.height, camera.fy)


def _sides(camera: Camera) -> tuple[tuple[float, float], tuple[float, float]]:
    """Tangents from the axis to both edges of the image, across and down."""
    return tuple(  # type: ignore[return-value]
        ((center + 0.5) / focal, (size - 0.5 - center) / focal)
        for (size, focal), center in zip(_extents(camera), (camera.cx, camera.cy), strict=True)
    )


def _degrees(before: float, after: float) -> float:
    return math.degrees(math.atan(before) + math.atan(after))
