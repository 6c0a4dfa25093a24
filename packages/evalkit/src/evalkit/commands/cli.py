"""The `evalkit` command. What takes long to import is imported where it is needed: `evalkit ap` answers in a blink."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from evalkit.atomic import write_json
from evalkit.commands.camera_command import camera
from evalkit.commands.described_inputs import described_inputs
from evalkit.commands.formats import depth, gt, preds
from evalkit.commands.group import Commands, suggest_next
from evalkit.commands.output_file import DOCUMENTS, DRAWINGS, PAGES, OutputFile
from evalkit.commands.verify_command import verify
from evalkit.datasets import documents
from evalkit.datasets.scene import SHARES, Share
from evalkit.errors import InputError
from evalkit.scoring.distances import CRITERIA
from evalkit.scoring.evaluation import average_precision
from evalkit.scoring.result import Result
from evalkit.scoring.rules import PROTOCOLS

FILE = click.Path(path_type=Path)
FIGURES = OutputFile(*DOCUMENTS)
NAMES_LISTED = 3


@click.group(cls=Commands)
@click.version_option(package_name="binpose-evalkit")
def main() -> None:
    """How good are 6D pose predictions? AP of poses in crowds, by rules that are stated."""


main.add_command(gt)
main.add_command(preds)
main.add_command(depth)
main.add_command(camera)
main.add_command(verify)


visibility_option = click.option(
    "--visibility",
    type=click.Choice(SHARES),
    help="The share of the silhouette that counts: where the instance is nearest, or only where depth has a return as "
    "well.  [gt.json's first]",
)


def evaluation_options(command: Any) -> Any:
    """The options that settle the rules of an evaluation."""
    options = [
        click.option("--criterion", type=click.Choice(list(CRITERIA)), default="sym", show_default=True),
        click.option("--protocol", type=click.Choice(list(PROTOCOLS)), default="sileane", show_default=True),
        click.option("--min-visibility", default=0.5, show_default=True, help="Find instances at least this visible."),
        visibility_option,
        click.option(
            "--threshold",
            type=float,
            help="A pose is right within this many diameters [0.1], for mspd pixels of an image 640 wide [10].",
        ),
        click.option("--max-results", type=int, help="Of each image, only this many best hypotheses count."),
    ]
    for option in reversed(options):
        command = option(command)
    return command


@main.command()
@click.argument("preds", required=False, type=FILE)
@click.argument("gt", required=False, type=FILE)
@evaluation_options
@click.option("--json", "json_path", type=FIGURES, help="Write all figures, the rules and the curve here.")
@click.option(
    "--plot", "plot_path", type=OutputFile(*DRAWINGS), help="Draw the precision-recall curve here (PNG, SVG or PDF)."
)
@click.option("--confidence", type=float, help="Also give precision, recall and F1 of the scores from this one on.")
@click.option("--bootstrap", type=int, help="Also give 95 % intervals from so many resamples of the scenes (1000).")
def ap(
    preds: Path | None,
    gt: Path | None,
    json_path: Path | None,
    plot_path: Path | None,
    confidence: float | None,
    bootstrap: int | None,
    **rules: Any,
) -> None:
    """Average precision of PREDS (preds.json) against GT (gt.json)."""
    preds, gt = both(preds, gt)
    result = average_precision(documents.read_predictions(preds), documents.read_ground_truth(gt), **rules)
    lines = [summary(result)]
    more: dict[str, Any] = {}
    if confidence is not None:
        precision, recall, f1 = result.at_confidence(confidence)
        more["at_confidence"] = {"score": confidence, "precision": precision, "recall": recall, "f1": f1}
        lines.append(f"score from {confidence:g} on: precision {precision:.4f}, recall {recall:.4f}, F1 {f1:.4f}")
    if bootstrap is not None:
        from evalkit.scoring.bootstrap import LEVEL, intervals

        found = intervals(result, bootstrap)
        more["bootstrap"] = {"resamples": bootstrap, "level": LEVEL} | {k: [i.low, i.high] for k, i in found.items()}
        lines.append(f"{bootstrap} resamples of the scenes, {100 * LEVEL:g} % intervals:")
        lines += [f"  {key:<8} {interval}" for key, interval in found.items()]
    if json_path is not None:
        inputs = described_inputs(predictions=preds, ground_truth=gt)
        write_json(json_path, {**result.to_json(), **more, "inputs": inputs}, indent=1)
    if plot_path is not None:
        from evalkit.drawing.precision_recall_plot import save_precision_recall

        save_precision_recall(result, plot_path)
    click.echo("\n".join(lines))
    suggest_next("evalkit", "report", preds, gt, "-o", "report.html")


@main.command("compare")
@click.argument("first", type=FILE)
@click.argument("second", type=FILE)
@click.argument("gt", type=FILE)
@evaluation_options
@click.option("--resamples", default=1000, show_default=True, help="Of the scenes, for the interval.")
@click.option("--json", "json_path", type=FIGURES, help="Write the figures here.")
def compare(first: Path, second: Path, gt: Path, resamples: int, json_path: Path | None, **rules: Any) -> None:
    """By how much SECOND is better than FIRST (two preds.json) on GT, and whether that is chance."""
    from evalkit.scoring.bootstrap import LEVEL, compare

    truth = documents.read_ground_truth(gt)
    a, b = (average_precision(documents.read_predictions(path), truth, **rules) for path in (first, second))
    found = compare(a, b, resamples)
    if json_path is not None:
        inputs = described_inputs(first=first, second=second, ground_truth=gt)
        write_json(json_path, {**found.to_json(), "protocol": a.protocol, "inputs": inputs}, indent=1)
    click.echo(f"AP of {first.name}: {found.first}")
    click.echo(f"AP of {second.name}: {found.second}")
    click.echo(f"difference: {found.difference}, higher in {100 * found.better:.1f} % of {resamples} resamples")
    click.echo(f"Intervals are {100 * LEVEL:g} %, by bootstrap over scenes, both on the same ones.")
    click.echo(f"\n{a.protocol}")


@main.command()
@click.argument("preds", type=FILE)
@click.argument("gt", type=FILE)
@click.option(
    "--max-results", type=click.IntRange(1), help="Of each image, only this many best count [100; of xyzibd 200]."
)
@visibility_option
@click.option("--json", "json_path", type=FIGURES, help="Write the figures here.")
def bop24(preds: Path, gt: Path, max_results: int | None, visibility: Share | None, json_path: Path | None) -> None:
    """BOP's detection scores of 2024 and 2025, as bop_toolkit computes them.

    AP over ladders of thresholds: MSSD in diameters and in millimeters, MSPD in pixels.
    """
    from evalkit.scoring.detection_ap import detection_ap

    found = detection_ap(documents.read_predictions(preds), documents.read_ground_truth(gt), max_results, visibility)
    if json_path is not None:
        inputs = described_inputs(predictions=preds, ground_truth=gt)
        write_json(json_path, {**found.to_json(), "inputs": inputs}, indent=1)
    for name, score in found.scores.items():
        click.echo(f"{name:<18} {score:.4f}")
    click.echo(f"\n{found.protocol}")


@main.command()
@click.argument("preds", required=False, type=FILE)
@click.argument("gt", required=False, type=FILE)
@click.option("--shards", type=FILE, help="The folder of shards that the images are from, to draw some of them.")
@click.option(
    "-o", "--output", type=OutputFile(*PAGES), required=True, help="The HTML page to write; its figures go beside it."
)
@click.option("--images", "count", type=click.IntRange(1, 36), default=8, show_default=True, help="How many to draw.")
@evaluation_options
def report(preds: Path | None, gt: Path | None, shards: Path | None, output: Path, count: int, **rules: Any) -> None:
    """Everything about an evaluation on one page that needs no network, and each figure as PNG and CSV."""
    from evalkit.reports.report import figures_folder, save_report

    preds, gt = both(preds, gt)
    predictions, truth = documents.read_predictions(preds), documents.read_ground_truth(gt)
    inputs = described_inputs(predictions=preds, ground_truth=gt)
    result = save_report(output, predictions, truth, shards, count, inputs, **rules)
    click.echo(f"{output}: AP {result.ap:.4f}; its figures are in {figures_folder(output)}")


@main.command()
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def published(as_json: bool) -> None:
    """What papers published, with their sources."""
    from evalkit.scoring import published

    click.echo(json.dumps(published.to_json(), indent=1) if as_json else published.as_text())


@main.command()
@click.argument("preds", type=FILE)
@click.argument("gt", type=FILE)
@click.option("--shards", type=FILE, required=True, help="The folder of shards that the images are from.")
@click.option("-o", "--output", type=OutputFile(*DRAWINGS), required=True, help="The PNG to write.")
@click.option("--image", "image_ids", multiple=True, help="Id of an image to draw; may be repeated.")
@click.option("--images", "count", type=click.IntRange(1, 36), default=4, show_default=True, help="How many to draw.")
@evaluation_options
def picture(
    preds: Path, gt: Path, shards: Path, output: Path, image_ids: tuple[str, ...], count: int, **rules: Any
) -> None:
    """Draw true, false, ignored and missed poses over their depth images, beside the precision-recall curve."""
    from evalkit.drawing.evaluation_picture import save_picture

    predictions, truth = documents.read_predictions(preds), documents.read_ground_truth(gt)
    result = save_picture(output, predictions, truth, shards, image_ids, count, **rules)
    click.echo(f"{output}: AP {result.ap:.4f}")


def both(preds: Path | None, gt: Path | None) -> tuple[Path, Path]:
    """The two documents of an evaluation.

    Raises:
        InputError: one is not given.
    """
    if preds is None or gt is None:
        raise InputError(
            "Missing PREDS and GT: give preds.json, which 'posenet predict' or 'evalkit preds' writes, and gt.json, "
            "which 'evalkit gt' writes."
        )
    return preds, gt


def summary(result: Result) -> str:
    """The figures as a small table, the rules in words below."""
    counts = result.counts
    lines = [
        f"AP                  {result.ap:.4f}",
        f"MAP                 {result.map:.4f}",
        f"best F1             {result.best_f1:.4f}",
        f"recall at P = 0.99  {result.recall_at_precision_99:.4f}",
        f"recall at P = 0.50  {result.recall_at_precision_50:.4f}",
        "",
        f"images              {counts['images']}{_missing(result)}",
        f"instances           {counts['instances']}, of them {counts['instances_to_find']} to find",
        f"hypotheses          {counts['hypotheses']}: {counts['true']} true, {counts['false']} false "
        f"({counts['duplicates']} of them duplicates), {counts['ignored']} ignored",
        "",
        result.protocol,
    ]
    return "\n".join(lines)


def _missing(result: Result) -> str:
    names = result.missing_images
    if not names:
        return ""
    listed = ", ".join(names[:NAMES_LISTED]) + (" …" if len(names) > NAMES_LISTED else "")
    skipped = result.settings.protocol == "sileane-toolbox"
    return f"; {len(names)} {'more skipped' if skipped else 'of them'} for want of predictions ({listed})"


if __name__ == "__main__":
    main()
