"""`posenet fit`, `predict`, `check`, `adapt`, `info`, `figures`, `export`, `compact`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from evalkit.commands.group import Commands
from evalkit.commands.image_options import image_options, opened
from evalkit.commands.output_file import DOCUMENTS, IMAGES, MODELS, OutputFile
from evalkit.errors import InputError
from posenet.commands.adapt_command import adapt
from posenet.commands.check_command import check
from posenet.commands.log import show_log
from posenet.commands.next_steps import after_fit, missing_model
from posenet.config import OPTIMIZERS, PRECISIONS, PRESETS, SCHEDULES, TASKS, Config, TrainConfig, preset, with_options


@click.group(cls=Commands)
@click.version_option(package_name="binpose-posenet")
def main() -> None:
    """Train on shards and predict the 6D poses of objects in crowds."""


main.add_command(check)
main.add_command(adapt)


@main.command()
@click.argument("shards", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", "out", type=click.Path(path_type=Path), help="The run's folder.  [default: runs/OBJECT-PRESET]"
)
@click.option("--preset", "preset_name", type=click.Choice(list(PRESETS)), default="small", show_default=True)
@click.option("--minutes", type=click.FloatRange(min=0, min_open=True), help="Train for so long, in all.")
@click.option("--epochs", type=click.IntRange(min=1), help="Train for so many passes over the shards, in all.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
@click.option(
    "--devices",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="GPUs, or processes on the CPU, that share every batch; the result is that of one.",
)
@click.option(
    "--scale",
    type=click.FloatRange(0, 1, min_open=True),
    help="Factor on the images' sides.  [default: so that objects are about 67 pixels across]",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--optimizer", type=click.Choice(OPTIMIZERS), default=None, help="What steps along the gradients.")
@click.option("--learning-rate", type=click.FloatRange(min=0, min_open=True), help="Peak learning rate.")
@click.option("--batch-images", type=click.IntRange(min=1), help="Images a step.")
@click.option("--schedule", type=click.Choice(SCHEDULES), default=None, help="How the learning rate goes.")
@click.option("--ema", type=click.FloatRange(0, 1, max_open=True), help="Keep the weights' moving average, e.g. 0.999.")
@click.option(
    "--augment",
    type=click.Choice(["on", "off"]),
    default=None,
    help="Draw depth cameras' errors on the fly, from none to a bad stereo camera's.  [default: on; paper: off]",
)
@click.option("--augment-noise", type=click.FloatRange(0, 1), help="Their largest noise, in diameters.")
@click.option("--augment-holes", type=click.FloatRange(0, 0.9), help="Their largest share of holes.")
@click.option(
    "--cut-frames/--no-cut-frames",
    default=None,
    help="Most steps see parts of their images, for objects that the frame cuts.  [default: on; paper: off]",
)
@click.option(
    "--backbone-weights", type=click.Path(path_type=Path), help="ImageNet's VGG16 (torchvision's file), --preset paper."
)
@click.option("--checkpoint-seconds", type=click.FloatRange(min=0), default=60.0, show_default=True)
@click.option("--validation/--no-validation", default=True, help="Hold scenes out and keep the best model by their AP.")
@click.option("--offset/--no-offset", default=None, help="Without: the box center stands in for the center.")
@click.option("--confidence", type=click.Choice(["product", "learned"]), help="Scores before registration.")
@click.option("--registration/--no-registration", default=None, help="Without: score = confidence.")
@click.option("--registration-cells", type=click.IntRange(0, 14), help="Cells a side that registration sees; 0: none.")
@click.option("--registration-weights", type=click.Choice(["paper", "balanced"]), default=None)
@click.option("--hypotheses", type=click.IntRange(1, 5), help="Poses a detection.")
@click.option("--orientation", type=click.Choice(["allocentric", "egocentric"]), default=None)
@click.option(
    "--norm", type=click.Choice(["batch", "group"]), default=None, help="Layers that normalize; group for tiny batches."
)
@click.option("--precision", type=click.Choice(["auto", "32", "bf16"]), default=None, help="Of the layers.")
@click.option("--tasks", help=f"Heads that learn; the others' losses are off.  [default: {','.join(TASKS)}]")
def fit(shards: tuple[Path, ...], out: Path | None, preset_name: str, **options: Any) -> None:
    """Train a network on SHARDS: a folder that `simgen build` wrote, or shard files.

    Without --minutes or --epochs it ends within the hour on two CPU cores, earlier where held-out AP no longer rises.
    Run the same command again to resume a run that was stopped; give more --minutes (in all) to go on with one that
    has ended. Ctrl-C keeps the state, and the best model so far.
    """
    if not shards:
        raise InputError("Missing SHARDS: give the folder that 'simgen build' wrote (shards/), or some of its files.")
    if options["minutes"] is not None and options["epochs"] is not None:
        raise click.UsageError("Give --minutes or --epochs, not both.")
    from posenet.commands.info import summary
    from posenet.training.fit_options import FitOptions
    from posenet.training.train import fit as train
    from posenet.training.train import intact_frames

    show_log()
    if out is None:
        out = Path("runs") / f"{intact_frames(list(shards)).model.name or 'object'}-{preset_name}"
    run = train(
        FitOptions(
            shards=list(shards),
            out=out,
            config=_configured(preset_name, options),
            minutes=options["minutes"],
            epochs=options["epochs"],
            device=options["device"],
            devices=options["devices"],
            scale=options["scale"],
            seed=options["seed"],
            validate=options["validation"],
            backbone_weights=options["backbone_weights"],
            checkpoint_seconds=options["checkpoint_seconds"],
            command=shlex.join(["posenet", *sys.argv[1:]]),
        )
    )
    click.echo(summary(run.path))
    after_fit(run.path, list(shards))


_TRAIN_OPTIONS = (
    "optimizer", "learning_rate", "batch_images", "schedule", "ema", "precision", "augment_noise", "augment_holes",
    "cut_frames",
)  # fmt: skip


def _configured(preset_name: str, options: dict[str, Any]) -> Config:
    config = preset(preset_name)
    network = {
        key: options[key]
        for key in ("offset", "confidence", "registration", "registration_cells", "hypotheses", "orientation", "norm")
    }
    config = with_options(config, "network", **network)
    tasks = tuple(options["tasks"].split(",")) if options["tasks"] is not None else None
    config = with_options(config, "loss", registration_weights=options["registration_weights"], tasks=tasks)
    if options["augment"] is not None:
        on = TrainConfig() if options["augment"] == "on" else preset("paper").train
        config = with_options(config, "train", augment_noise=on.augment_noise, augment_holes=on.augment_holes)
    train = {key: options[key] for key in _TRAIN_OPTIONS}
    return with_options(config, "train", **train)


@main.command()
@click.argument("model", required=False, type=click.Path(path_type=Path))
@click.argument("source", required=False, type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "out",
    type=OutputFile(*DOCUMENTS, ".csv", document="binpose-preds"),
    default="preds.json",
    show_default=True,
    help="preds.json, or BOP's results as .csv.",
)
@image_options
@click.option("--object-id", type=click.IntRange(min=0), help="BOP's number of the object, for -o results.csv.")
@click.option("--mask", type=click.Path(path_type=Path), help="Look only where this image is not black: the bin.")
@click.option("--roi", help="Look only at these pixels: X0,Y0,X1,Y1.")
@click.option("--picture", type=OutputFile(*IMAGES), help="Draw the poses on the (first) image, as PNG.")
@click.option("--picture-score", type=float, default=0.5, show_default=True, help="Draw poses scored at least this.")
@click.option(
    "--refine/--no-refine",
    default=None,
    help="Fit each pose to the depth image and verify the set.  [default: no, with --also yes]",
)
@click.option(
    "--also",
    multiple=True,
    type=click.Path(path_type=Path),
    help="The model of another part in the same bin; may be repeated. Refined poses of all compete for what the image "
    "shows; the other part's are written beside OUT, as preds-NAME.json.",
)
@click.option("--max-images", type=click.IntRange(min=1), help="Only so many images, spread over the source.")
@click.option("--no-registration", is_flag=True, help="Ablation: score = confidence.")
@click.option("--no-offset", is_flag=True, help="Ablation: the box center stands in for the center.")
@click.option("--hypotheses", type=click.IntRange(1, 5), help="Ablation: at most so many poses a detection.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
@click.option(
    "--precision",
    type=click.Choice(PRECISIONS),
    default="auto",
    show_default=True,
    help="Of the layers; auto: bfloat16 where the CPU or GPU has it, for it is faster there.",
)
def predict(
    model: Path | None,
    source: Path | None,
    no_registration: bool,
    no_offset: bool,
    hypotheses: int | None,
    mask: Path | None,
    roi: str | None,
    **options: Any,
) -> None:
    """Predict poses with MODEL (a model file or a run's folder) on SOURCE.

    SOURCE is a folder of shards or one shard; one depth image (16-bit PNG, TIFF, NPY, EXR, organized PLY or PCD) or a
    folder of them, with --camera and, for whole numbers, --depth-unit; a split or a scene of a BOP dataset
    (DATASET/test/000001), or with --targets the dataset; or a folder of the Siléane dataset (camera_params.txt beside
    depth/*.png). Images are named as their files, without the suffix.
    """
    from posenet.commands import predict as commands
    from posenet.network.predict_options import PredictOptions
    from posenet.prediction.area_of_interest import AreaOfInterest

    if model is None:
        raise missing_model()
    show_log()
    images = opened(source, options, "to predict on")
    switched = PredictOptions(not no_registration, not no_offset, hypotheses)
    refine = options.pop("refine")
    options["refine"] = bool(options["also"]) if refine is None else refine
    click.echo(commands.predict(model, images, options=switched, area=AreaOfInterest(mask, roi), **options))


@main.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Everything, as JSON.")
def info(model: Path, as_json: bool) -> None:
    """Print what a model was trained on, how long, and how well it validated."""
    from posenet.commands.info import summary

    click.echo(summary(model, as_json))


@main.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("shards", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), default="figures", show_default=True)
@click.option("--frame", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the frame drawn on.")
def figures(model: Path, shards: Path, out: Path, frame: int) -> None:
    """Draw how MODEL works: its angle bins, one detection's hypotheses, and the registration's relation features.

    SHARDS are of the kind that the model was trained on; one of their frames is drawn on.
    """
    from posenet.figures import draw_figures
    from posenet.models.model_file import load_model

    for path in draw_figures(load_model(model).network, shards, out, frame):
        click.echo(path)


@main.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=OutputFile(".onnx"), default="model.onnx", show_default=True)
def export(model: Path, out: Path) -> None:
    """Write MODEL as ONNX, for what runs without Python.

    Four files: OUT takes a depth image to features and scored boxes, OUT-regions.onnx boxes to poses, OUT-scores.onnx
    poses to scores; OUT.json holds the rules between them, which docs/onnx.md explains. examples/onnx_decoder.py gives
    the poses of predict from them. Needs pip install 'binpose-posenet[export]'.
    """
    from posenet.exports import onnx_export
    from posenet.models.model_file import load_model

    for path in onnx_export.export(load_model(model).network, out):
        click.echo(path)


@main.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.option("-o", "--output", "out", type=OutputFile(*MODELS), default="compact.pt", show_default=True)
def compact(model: Path, out: Path) -> None:
    """Write MODEL in a quarter of the bytes, to hand on: weights in 8 bits a row, else 16. Score it before you do."""
    from posenet.models.model_file import write_compact

    click.echo(f"{out}: {write_compact(model, out) / 1e6:.1f} MB")
