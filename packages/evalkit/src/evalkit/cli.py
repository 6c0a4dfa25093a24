"""The `evalkit` command. What takes long to import is imported where it is needed: `evalkit ap` answers in a blink."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from evalkit import documents
from evalkit.atomic import sha256_of_file, write_json
from evalkit.command import Commands
from evalkit.distances import CRITERIA
from evalkit.errors import InputError
from evalkit.evaluation import PROTOCOLS, Result, average_precision

FILE = click.Path(path_type=Path)
NAMES_LISTED = 3
GT_SOURCES = {  # of each source, the options that it takes
    "shards": (),
    "sileane": ("object_name", "camera_params"),
    "bop": ("object_id",),
    "icvl": ("mesh", "visibility"),
    "ipa": ("mesh",),
}
PREDS_SOURCES = {"sileane": ("object_name", "camera_params"), "bop": ("object_id",)}
PREDS_TARGETS = {"sileane": ("camera_params",), "bop": ("object_id",)}


@click.group(cls=Commands)
@click.version_option(package_name="binpose-evalkit")
def main() -> None:
    """How good are 6D pose predictions? AP of poses in crowds, by rules that are stated."""


def evaluation_options(command: Any) -> Any:
    """The options that settle the rules of an evaluation."""
    options = [
        click.option("--criterion", type=click.Choice(list(CRITERIA)), default="sym", show_default=True),
        click.option("--protocol", type=click.Choice(PROTOCOLS), default="sileane", show_default=True),
        click.option("--min-visibility", default=0.5, show_default=True, help="Find instances at least this visible."),
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
@click.argument("preds", type=FILE)
@click.argument("gt", type=FILE)
@evaluation_options
@click.option("--json", "json_path", type=FILE, help="Write all figures, the rules and the curve here.")
@click.option("--plot", "plot_path", type=FILE, help="Draw the precision-recall curve here (PNG, SVG or PDF).")
@click.option("--confidence", type=float, help="Also give precision, recall and F1 of the scores from this one on.")
@click.option("--bootstrap", type=int, help="Also give 95 % intervals from so many resamples of the scenes (1000).")
def ap(
    preds: Path,
    gt: Path,
    json_path: Path | None,
    plot_path: Path | None,
    confidence: float | None,
    bootstrap: int | None,
    **rules: Any,
) -> None:
    """Average precision of PREDS (preds.json) against GT (gt.json)."""
    result = average_precision(documents.read_predictions(preds), documents.read_ground_truth(gt), **rules)
    lines = [summary(result)]
    more: dict[str, Any] = {}
    if confidence is not None:
        precision, recall, f1 = result.at_confidence(confidence)
        more["at_confidence"] = {"score": confidence, "precision": precision, "recall": recall, "f1": f1}
        lines.append(f"score from {confidence:g} on: precision {precision:.4f}, recall {recall:.4f}, F1 {f1:.4f}")
    if bootstrap is not None:
        from evalkit.bootstrap import LEVEL, intervals

        found = intervals(result, bootstrap)
        more["bootstrap"] = {"resamples": bootstrap, "level": LEVEL} | {k: [i.low, i.high] for k, i in found.items()}
        lines.append(f"{bootstrap} resamples of the scenes, {100 * LEVEL:g} % intervals:")
        lines += [f"  {key:<8} {interval}" for key, interval in found.items()]
    if json_path is not None:
        inputs = described_inputs(predictions=preds, ground_truth=gt)
        write_json(json_path, {**result.to_json(), **more, "inputs": inputs}, indent=1)
    if plot_path is not None:
        from evalkit.plots import save_precision_recall

        save_precision_recall(result, plot_path)
    click.echo("\n".join(lines))


@main.command("compare")
@click.argument("first", type=FILE)
@click.argument("second", type=FILE)
@click.argument("gt", type=FILE)
@evaluation_options
@click.option("--resamples", default=1000, show_default=True, help="Of the scenes, for the interval.")
@click.option("--json", "json_path", type=FILE, help="Write the figures here.")
def compare(first: Path, second: Path, gt: Path, resamples: int, json_path: Path | None, **rules: Any) -> None:
    """By how much SECOND is better than FIRST (two preds.json) on GT, and whether that is chance."""
    from evalkit.bootstrap import LEVEL, compare

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
@click.option("--unit", type=click.Choice(["diameter", "mm"]), default="diameter", show_default=True)
@click.option("--json", "json_path", type=FILE, help="Write the figures here.")
def bop24(preds: Path, gt: Path, unit: str, json_path: Path | None) -> None:
    """The detection score of BOP Challenge 2024: AP over a ladder of MSSD and MSPD thresholds."""
    from evalkit.detection_ap import detection_ap

    found = detection_ap(documents.read_predictions(preds), documents.read_ground_truth(gt), unit)
    if json_path is not None:
        inputs = described_inputs(predictions=preds, ground_truth=gt)
        write_json(json_path, {**found.to_json(), "inputs": inputs}, indent=1)
    click.echo(
        f"AP       {found.ap:.4f}\nAP MSSD  {found.ap_mssd:.4f}\nAP MSPD  {found.ap_mspd:.4f}\n\n{found.protocol}"
    )


@main.command()
@click.argument("source", type=FILE)
@click.option("--from", "kind", type=click.Choice(list(GT_SOURCES)), default="shards", show_default=True)
@click.option("-o", "--output", type=FILE, required=True, help="The gt.json to write.")
@click.option("--object", "object_name", help="sileane: the object's name, where the folder's is not it.")
@click.option("--camera-params", type=FILE, help="sileane: camera_params.txt, where it is not beside gt/.")
@click.option("--object-id", type=int, help="bop: which object, where there are several.")
@click.option("--mesh", type=FILE, help="icvl, ipa: the object's mesh.")
@click.option("--visibility", type=FILE, help="icvl: a file of visibilities, which the set itself lacks.")
def gt(source: Path, kind: str, output: Path, **options: Any) -> None:
    """Write the ground truth of SOURCE (a folder) as gt.json."""
    truth = adapter(kind, "read_ground_truth", GT_SOURCES[kind], options)(source)
    documents.write_ground_truth(output, truth)
    instances = sum(len(image.visibility) for image in truth.images)
    click.echo(
        f"{output}: {len(truth.images)} images, {instances} instances of {truth.object.name}, {truth.frame} frame"
    )


@main.command()
@click.argument("source", type=FILE)
@click.option("--from", "source_kind", type=click.Choice(list(PREDS_SOURCES)), help="SOURCE is somebody's results.")
@click.option("--to", "target_kind", type=click.Choice(list(PREDS_SOURCES)), help="SOURCE is a preds.json.")
@click.option("-o", "--output", type=FILE, required=True, help="The preds.json to write, or with --to their file.")
@click.option("--object", "object_name", help="sileane: the object's name, where the folder's is not it.")
@click.option("--camera-params", type=FILE, help="sileane: camera_params.txt, where it is not beside the results.")
@click.option("--object-id", type=int, help="bop: which object, where there are several.")
def preds(source: Path, source_kind: str | None, target_kind: str | None, output: Path, **options: Any) -> None:
    """Turn somebody's results into a preds.json (--from), or a preds.json into theirs (--to)."""
    if (source_kind is None) == (target_kind is None):
        raise click.UsageError("give one of --from and --to")
    if target_kind is not None:
        predictions = documents.read_predictions(source)
        adapter(target_kind, "write_predictions", PREDS_TARGETS[target_kind], options)(output, predictions)
    if source_kind is not None:
        predictions = adapter(source_kind, "read_predictions", PREDS_SOURCES[source_kind], options)(source)
        documents.write_predictions(output, predictions)
    hypotheses = sum(len(image.score) for image in predictions.images)
    click.echo(f"{output}: {len(predictions.images)} images, {hypotheses} hypotheses, {predictions.frame} frame")


@main.command()
@click.argument("preds", type=FILE)
@click.argument("gt", type=FILE)
@click.option("--shards", type=FILE, help="The folder of shards that the images are from, to draw some of them.")
@click.option("-o", "--output", type=FILE, required=True, help="The HTML page to write; its figures go beside it.")
@click.option("--images", "count", type=click.IntRange(1, 36), default=8, show_default=True, help="How many to draw.")
@evaluation_options
def report(preds: Path, gt: Path, shards: Path | None, output: Path, count: int, **rules: Any) -> None:
    """Everything about an evaluation on one page that needs no network, and each figure as PNG and CSV."""
    from evalkit.report import figures_folder, save_report

    predictions, truth = documents.read_predictions(preds), documents.read_ground_truth(gt)
    inputs = described_inputs(predictions=preds, ground_truth=gt)
    result = save_report(output, predictions, truth, shards, count, inputs, **rules)
    click.echo(f"{output}: AP {result.ap:.4f}; its figures are in {figures_folder(output)}")


@main.command()
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def published(as_json: bool) -> None:
    """What papers published, with their sources."""
    from evalkit import published

    click.echo(json.dumps(published.to_json(), indent=1) if as_json else published.as_text())


@main.command()
@click.argument("preds", type=FILE)
@click.argument("gt", type=FILE)
@click.option("--shards", type=FILE, required=True, help="The folder of shards that the images are from.")
@click.option("-o", "--output", type=FILE, required=True, help="The PNG to write.")
@click.option("--image", "image_ids", multiple=True, help="Id of an image to draw; may be repeated.")
@click.option("--images", "count", type=click.IntRange(1, 36), default=4, show_default=True, help="How many to draw.")
@evaluation_options
def picture(
    preds: Path, gt: Path, shards: Path, output: Path, image_ids: tuple[str, ...], count: int, **rules: Any
) -> None:
    """Draw true, false, ignored and missed poses over their depth images, beside the precision-recall curve."""
    from evalkit.picture import save_picture

    predictions, truth = documents.read_predictions(preds), documents.read_ground_truth(gt)
    result = save_picture(output, predictions, truth, shards, image_ids, count, **rules)
    click.echo(f"{output}: AP {result.ap:.4f}")


def adapter(kind: str, action: str, takes: tuple[str, ...], options: dict[str, Any]) -> Callable[..., Any]:
    """The function `action` of the adapter of that name, with those of the options that it takes.

    Raises:
        InputError: an option was given that means nothing there.
    """
    given = {name: value for name, value in options.items() if value is not None}
    foreign = next((name for name in given if name not in takes), None)
    if foreign is not None:
        option = "--" + foreign.removesuffix("_name").replace("_", "-")
        raise InputError(f"{option} means nothing for {kind}; leave it out.")
    module = "evalkit.ground_truth" if kind == "shards" else f"evalkit.adapters.{kind}"
    return partial(getattr(import_module(module), action), **given)


def described_inputs(**paths: Path) -> dict[str, dict[str, str]]:
    """Names and hashes of the files that a result was computed from."""
    return {key: {"file": path.name, "sha256": sha256_of_file(path)} for key, path in paths.items()}


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
        f"images              {counts['images']}{_missing(result.missing_images)}",
        f"instances           {counts['instances']}, of them {counts['instances_to_find']} to find",
        f"hypotheses          {counts['hypotheses']}: {counts['true']} true, {counts['false']} false "
        f"({counts['duplicates']} of them duplicates), {counts['ignored']} ignored",
        "",
        result.protocol,
    ]
    return "\n".join(lines)


def _missing(names: list[str]) -> str:
    if not names:
        return ""
    listed = ", ".join(names[:NAMES_LISTED]) + (" …" if len(names) > NAMES_LISTED else "")
    return f", of them {len(names)} without predictions ({listed})"


if __name__ == "__main__":
    main()
