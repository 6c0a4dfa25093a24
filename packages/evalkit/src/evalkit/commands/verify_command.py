"""`evalkit verify`: poses held against their depth images, where nobody knows the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evalkit.commands.command import Command
from evalkit.commands.described_inputs import described_inputs
from evalkit.commands.image_options import image_options, opened
from evalkit.commands.output_file import DOCUMENTS, IMAGES, OutputFile
from evalkit.errors import InputError
from evalkit.meshes.units import CHOICES

if TYPE_CHECKING:
    from evalkit.depth.sources import DepthSource
    from evalkit.evidence.verification import Verification
    from evalkit.objects.model import ObjectModel

FILE = click.Path(path_type=Path)
LISTED = 20  # contradicted poses


@click.command(cls=Command)
@click.argument("preds", type=FILE)
@click.argument("source", type=FILE)
@click.option("--mesh", type=FILE, help="The part: PLY, STL, OBJ, GLB, STEP …; shards bring their own.")
@click.option("--units", type=click.Choice(CHOICES), help="The mesh's unit; by default decided by its size, aloud.")
@click.option("--symmetry", help="auto, none, cyclic:N, revolution@z …  [default: auto]")
@click.option("--min-score", type=float, default=0.5, show_default=True, help="Look at poses scored at least this.")
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0, min_open=True),
    help="Depth agrees within so many meters.  [default: 0.035 diameters, more in noisy images]",
)
@image_options
@click.option(
    "--json",
    "json_path",
    type=OutputFile(*DOCUMENTS, document="binpose-verification"),
    help="Write every pose's verdict and reason here.",
)
@click.option(
    "--picture", type=OutputFile(*IMAGES), help="Draw the poses over their depth images on one contact sheet, a PNG."
)
@click.option("--max-drawn", type=click.IntRange(min=1), default=24, show_default=True, help="Images on the sheet.")
def verify(
    preds: Path,
    source: Path,
    mesh: Path | None,
    units: str | None,
    symmetry: str | None,
    min_score: float,
    tolerance: float | None,
    json_path: Path | None,
    picture: Path | None,
    max_drawn: int,
    **options: Any,
) -> None:
    """Score PREDS (preds.json) on the depth images of SOURCE without ground truth.

    SOURCE is what was predicted on: a folder of depth images with --camera, shards, a BOP or Siléane folder. The part
    is ray traced at each pose, after the pose was fitted to the image. A pose is

    \b
    verified      where the depth measured is the part's, and the fit moved it by less than 0.1 diameters (Sym)
    contradicted  where the camera looks through the part, or the image shows it elsewhere
    undecided     where too little of it is seen, or its surface goes on beyond it, as a floor's does

    Of several verified poses of one part, one counts; the others are duplicates, and count against precision.
    """
    from evalkit.datasets.documents import read_predictions
    from evalkit.evidence.verification import verify

    predictions, images = read_predictions(preds), opened(source, options, "that were predicted on")
    model = _model(images, mesh, units, symmetry)
    found = verify(predictions, images, model, min_score, tolerance)
    if json_path is not None:
        from evalkit.atomic import write_json

        write_json(json_path, {**found.to_json(), "inputs": described_inputs(predictions=preds)}, indent=1)
    if picture is not None:
        _draw(picture, found, images, max_drawn)
    click.echo(summary(found))


def _draw(path: Path, found: Verification, images: DepthSource, most: int) -> None:
    from evalkit.evidence.verdict_picture import MEANING, caption, draw_verdicts, write_sheet

    tiles = []
    for image in found.images[:most]:
        number = images.names.index(image.id)
        drawn = draw_verdicts(images.depth(number), images.cameras[number], found.model, image)
        tiles.append((caption(image), drawn))
    write_sheet(path, tiles)
    click.echo(f"{path}: {len(tiles)} of {len(found.images)} images; {MEANING}", err=True)


def _model(images: DepthSource, mesh: Path | None, units: str | None, symmetry: str | None) -> ObjectModel:
    """The part of the mesh, or else the one that the images' source knows."""
    if mesh is not None:
        from evalkit.meshes.load import load_object

        return load_object(mesh, units, symmetry)
    if units is not None or symmetry is not None:
        raise InputError("--units and --symmetry are about the mesh; give --mesh.")
    if images.model is None:
        raise InputError(f"{images.path}: these images do not say what part they show; give --mesh, its CAD model.")
    return images.model


def summary(found: Verification) -> str:
    """The figures as a small table, contradicted poses below."""
    from evalkit.evidence.verdict import Verdict

    verified, contradicted, undecided = (found.count(verdict) for verdict in Verdict)
    lines = [
        f"images        {len(found.images)}",
        f"poses         {sum(len(image.score) for image in found.images)} scored at least {found.min_score:g}",
        f"verified      {verified} instances",
        f"duplicates    {found.duplicates}",
        f"contradicted  {contradicted}",
        f"undecided     {undecided}",
        f"precision     {found.precision:.3f}, of the poses that are decided",
    ]
    listed = [
        f"  {image.id}: hypothesis {image.row[n]}, scored {image.score[n]:.2f}: {image.evidence[n].reason}"
        for image in found.images
        for n in image.are(Verdict.CONTRADICTED).nonzero()[0]
    ]
    if listed:
        more = f"  … and {len(listed) - LISTED} more, in --json" if len(listed) > LISTED else None
        lines += ["", "contradicted:", *listed[:LISTED], *([more] if more else [])]
    return "\n".join(lines)
