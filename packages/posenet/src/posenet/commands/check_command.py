"""`posenet check`: will a model work on these images?"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evalkit.commands.command import Command
from evalkit.commands.image_options import as_typed, image_options, opened
from evalkit.commands.output_file import DOCUMENTS, PAGES, OutputFile
from posenet.commands.log import show_log

if TYPE_CHECKING:
    from posenet.checking.advice import Finding
    from posenet.checking.site import Site

FILE = click.Path(path_type=Path)


@click.command(cls=Command)
@click.argument("model", type=FILE)
@click.argument("frames", type=FILE)
@image_options
@click.option("--mask", type=FILE, help="Look only where this image is not black: the bin.")
@click.option("--roi", help="Look only at these pixels: X0,Y0,X1,Y1.")
@click.option("--max-images", type=click.IntRange(min=1), default=10, show_default=True, help="Spread over FRAMES.")
@click.option(
    "-o",
    "--output",
    "out",
    type=OutputFile(*PAGES),
    default="check.html",
    show_default=True,
    help="The HTML page to write.",
)
@click.option(
    "--json", "json_path", type=OutputFile(*DOCUMENTS, document="binpose-check"), help="Write the figures here."
)
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
def check(
    model: Path,
    frames: Path,
    mask: Path | None,
    roi: str | None,
    max_images: int,
    out: Path,
    json_path: Path | None,
    device: str,
    **options: Any,
) -> None:
    """Will MODEL work on FRAMES, images of your own camera? What it was trained for beside what it meets there.

    No ground truth is needed: the poses that it finds and refines are held against the images. Each doubt comes with
    what to do about it; the page shows the poses over the images.
    """
    from tqdm import tqdm

    from evalkit.drawing.page import require_page_name
    from posenet.checking.advice import VERDICTS, findings, worst
    from posenet.checking.check_page import save_page
    from posenet.checking.site import Site, look_at
    from posenet.prediction.area_of_interest import AreaOfInterest
    from posenet.prediction.predictor import Predictor

    require_page_name(out)
    show_log()
    typed = shlex.join([str(frames), *as_typed(options)])
    source = opened(frames, options, "to check the model on")
    predictor = Predictor.load(model, device, refine=True)
    numbers = source.spread(max_images)
    seen = look_at(predictor, source, numbers, AreaOfInterest(mask, roi))
    site = Site(list(tqdm(seen, total=len(numbers), desc="check", unit=" images")), predictor.model)
    found = findings(site, predictor.network, predictor.record, shlex.quote(str(model)), typed)
    save_page(out, site, found, model, frames)
    if json_path is not None:
        from evalkit.atomic import write_json

        write_json(json_path, to_json(site, found), indent=1)
    click.echo("\n".join([*map(_line, found), "", VERDICTS[worst(found)], f"{out} shows the poses over the images."]))


def _line(finding: Finding) -> str:
    mark = ("ok", "?", "!")[finding.grade]
    trained = "" if finding.title in ("Poses", "Explained by verified poses") else f" (trained for: {finding.trained})"
    mend = f"\n   {finding.mend}" if finding.mend else ""
    return f"{mark:<2} {finding.title}: {finding.here}{trained}{mend}"


def to_json(site: Site, found: list[Finding]) -> dict[str, Any]:
    """The figures and findings of a check."""
    from evalkit.evidence.verdict import Verdict

    return {
        "format": "binpose-check/1",
        "images": len(site.images),
        **{verdict.value: site.count(verdict) for verdict in Verdict},
        "explained": site.explained,
        "distance_m": site.distance,
        "object_pixels": site.pixels,
        "noise_m": site.noise,
        "holes": site.holes,
        "findings": [{**finding._asdict(), "grade": finding.grade.name.lower()} for finding in found],
    }
