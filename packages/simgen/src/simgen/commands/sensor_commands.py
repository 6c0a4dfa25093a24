"""`simgen sensor`: what depth camera took these images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from evalkit.atomic import write_text
from evalkit.commands.group import Commands, suggest_next
from evalkit.commands.image_options import image_options, opened
from evalkit.commands.output_file import DOCUMENTS, PAGES, OutputFile
from evalkit.drawing.page import require_page_name
from evalkit.errors import InputError


@click.group("sensor", cls=Commands)
def sensor_group() -> None:
    """A depth camera's errors, learned from its images."""


@sensor_group.command("fit")
@click.argument("frames", required=False, type=click.Path(path_type=Path))
@image_options
@click.option(
    "-o",
    "--output",
    type=OutputFile(*DOCUMENTS, document="binpose-sensor"),
    default=Path("sensor.json"),
    show_default=True,
)
@click.option("--page", type=OutputFile(*PAGES), help="HTML page on the fit.  [default: OUTPUT with .html]")
@click.option("--baseline", type=float, help="Meters between the eyes, if known; negative: the second on the left.")
@click.option("--mesh", help="The part, a mesh file or a built-in object: simulated heaps of it are shown beside.")
@click.option("--name", help="What the sensor is called.  [default: the output's name]")
def fit_command(
    frames: Path | None,
    output: Path,
    page: Path | None,
    baseline: float | None,
    mesh: str | None,
    name: str | None,
    **options: Any,
) -> None:
    """Fit a sensor to FRAMES, at least three depth images of your camera, for `simgen build --sensor sensor.json`.

    FRAMES is a folder of depth images, of one scene that stands still or of several heaps, or of shards. Noise by
    distance and slope, its correlation, what is missing by slope and on each side of steps, steps of depth and flying
    pixels are measured; then a sensor is searched for whose errors, drawn on the same surfaces, have the same figures.
    A page shows both.
    """
    from simgen.objects.prepare import prepare_object
    from simgen.sensor_fit.fit import fit_sensor
    from simgen.sensor_fit.fit_page import fit_page
    from simgen.sensor_fit.frames import MOST_FRAMES, checked_frames
    from simgen.sensor_fit.heaps import heap_images
    from simgen.sensor_fit.statistics import statistics_of
    from simgen.sensor_fit.twin_agreement import rows
    from simgen.sensors.sensor_file import write_sensor

    if frames is None:
        raise InputError("Missing FRAMES: give a folder of at least three depth images of your camera, or of shards.")
    if output.suffix != ".json":
        raise InputError(f"-o {output}: a sensor file's name ends in .json, so that --sensor knows it.")
    page = output.with_suffix(".html") if page is None else page
    require_page_name(page)
    if baseline is not None and not 1e-3 <= abs(baseline) <= 10:
        raise InputError(f"--baseline {baseline:g}: give meters, as in 0.05.")
    images = opened(frames, options, "to fit a sensor to")
    picked = images.spread(MOST_FRAMES)
    names = [images.names[number] for number in picked]
    found = checked_frames(
        names, [images.read(number) for number in picked], [images.cameras[number] for number in picked], str(frames)
    )
    part = None if mesh is None else prepare_object(mesh)
    fitted = fit_sensor(found, baseline, name or output.stem)
    if part is not None:
        heap, camera = heap_images(part, found, fitted.sensor)
        fitted = replace(fitted, heap=statistics_of(heap, camera, static=False))
    judged = [row for row in rows(fitted.real, fitted.twin, found.camera.fx) if row.judged]
    figures = {row.name: {"camera": row.real, "twin": row.twin, "unit": row.unit} for row in judged}
    write_text(page, fit_page(fitted, found))
    write_sensor(output, fitted.sensor, {"frames": names, "static": found.static, "figures": figures})
    click.echo(fitted.sensor.describe(found.camera, *found.distances))
    for row in judged:
        verdict = "" if row.agrees else f"  differs by more than {row.tolerance:.2g}"
        click.echo(f"{row.name:58}{row.real:8.3g} {row.twin:8.3g} {row.unit:3}{verdict}".rstrip())
    click.echo(f"{output}: {sum(row.agrees for row in judged)} of {len(judged)} figures agree; {page} shows them.")
    suggest_next("simgen", "build", "--object", "part.stl", "--sensor", output)
