"""`evalkit gt`, `preds` and `depth`: everyone's files to ours, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from evalkit import adapters
from evalkit.commands.command import Command
from evalkit.commands.group import suggest_next
from evalkit.commands.output_file import DOCUMENTS, OutputFile
from evalkit.datasets import documents
from evalkit.datasets.visibility_share import in_words
from evalkit.errors import InputError
from evalkit.meshes.units import CHOICES

FILE = click.Path(path_type=Path)
GT = OutputFile(*DOCUMENTS, document="binpose-gt")
PREDS = OutputFile(*DOCUMENTS, ".csv", document="binpose-preds", or_folder=True)
SOURCE_OPTIONS = [
    click.option("--object", "object_name", help="Name the object so in the document."),
    click.option("--object-id", type=click.IntRange(min=0), help="BOP's number of the object.  [bop]"),
    click.option("--mesh", type=FILE, help="The object's mesh: PLY, STL, OBJ, GLB, STEP …  [bop, icvl, ipa]"),
    click.option("--units", type=click.Choice(CHOICES), help="The mesh's unit; by default decided by its size, aloud."),
    click.option("--symmetry", help="auto, none, cyclic:N, revolution@z …, in place of the dataset's or the mesh's."),
    click.option(
        "--visibility",
        help="geometric (of the silhouette, all where the instance is nearest) or returned (only where depth has a "
        "return): by which scores go; shards hold both.  [geometric; sileane: returned]  Also depth (both estimated "
        "from the depth images), full, or FILE.json, by image.  [bop, icvl]",
    ),
    click.option("--camera", type=FILE, help="The camera as JSON, in place of the dataset's.  [icvl, ipa]"),
    click.option("--camera-params", type=FILE, help="camera_params.txt, where it is not beside the files.  [sileane]"),
    click.option("--sensor", help="Of a set with several sensors, this one, such as cam1.  [bop]"),
    click.option("--targets", type=FILE, help="Only the images that test_targets_*.json lists.  [bop]"),
    click.option("--width", type=click.IntRange(1), help="Image width where the files do not give it.  [bop]"),
    click.option("--height", type=click.IntRange(1), help="Image height where the files do not give it.  [bop]"),
    click.option(
        "--mesh-frame",
        is_flag=True,
        default=None,
        help="Of a set by 'simgen export bop': poses of the mesh in its own frame, as shards and posenet have them.  "
        "[bop]",
    ),
]


def source_options(command: Any) -> Any:
    """Every option that some format's ground truth takes."""
    for option in reversed(SOURCE_OPTIONS):
        command = option(command)
    return command


@click.command(cls=Command)
@click.argument("source", type=FILE)
@click.option("--from", "kind", type=click.Choice(list(adapters.GROUND_TRUTH)), default="shards", show_default=True)
@click.option("-o", "--output", type=GT, required=True, help="The gt.json to write.")
@source_options
def gt(source: Path, kind: str, output: Path, **options: Any) -> None:
    """Write the ground truth of SOURCE (a folder) as gt.json.

    \b
    --from   SOURCE                              needs
    shards   a folder of shards                  nothing
    sileane  OBJECT (poseutils.json, gt/)        camera_params.txt for poses in the camera's frame
    bop      DATASET/test, or one of its scenes  --object-id where several objects are annotated
    icvl     test, or test/01                    --mesh --units, --visibility; --object where there are several
    ipa      OBJECT (parameter.json, gt/)        --mesh --units
    """
    known = adapters.options_of(adapters.GROUND_TRUTH, kind)
    adapters.refuse_unknown(options, known, f"--from {kind}")
    truth = adapters.function(adapters.GROUND_TRUTH, kind)(source, **adapters.given(options, known))
    documents.write_ground_truth(output, truth)
    for remark in truth.remarks:
        click.echo(f"Note: {remark}", err=True)
    instances = sum(len(image.visibility) for image in truth.images)
    model = truth.object
    click.echo(
        f"{output}: {len(truth.images)} images, {instances} instances of {model.title} "
        f"({1e3 * model.diameter:.4g} mm across, symmetry {model.symmetry.name}), {truth.frame} frame, "
        f"visibility: {in_words(truth.share)}"
    )
    preds = output.with_name("preds.json")
    if preds.is_file():
        suggest_next("evalkit", "ap", preds, output)
    else:
        suggest_next("posenet", "predict", "MODEL", source, "--refine", "-o", preds)


@click.command(cls=Command)
@click.argument("source", type=FILE)
@click.option("--from", "kind", type=click.Choice(list(adapters.PREDICTIONS)), default="binpose", show_default=True)
@click.option("--to", "target", type=click.Choice(list(adapters.WRITERS)), default="binpose", show_default=True)
@click.option("-o", "--output", type=PREDS, required=True, help="The file, for sileane the folder, to write.")
@click.option("--object", "object_name", help="Name the object so in the document.")
@click.option("--object-id", type=click.IntRange(min=0), help="BOP's number of the object.  [bop]")
@click.option(
    "--models-info",
    type=FILE,
    help="models_info.json of a set by 'simgen export bop', between BOP's frame and the mesh's own.  [bop]",
)
@click.option("--camera-params", type=FILE, help="camera_params.txt, between camera and world.  [sileane]")
def preds(source: Path, kind: str, target: str, output: Path, **options: Any) -> None:
    """Write anybody's results in SOURCE as preds.json, or as somebody else's format.

    \b
    --from, --to  SOURCE or output
    binpose       preds.json
    bop           results.csv: scene_id,im_id,obj_id,score,R,t,time
    sileane       a folder of SCENE.json, poses in the world's frame
    icvl          as its ground truth, with the score as a fifth line below each matrix  [--from only]
    ipa           as its ground truth, with the score in place of the visibility  [--from only]
    shards        the labels themselves, scored by visibility: a method without errors  [--from only]
    """
    if kind == target:
        raise click.UsageError("say whose results SOURCE is with --from, or whose to write with --to.")
    reads = adapters.options_of(adapters.PREDICTIONS, kind)
    writes = adapters.options_of(adapters.WRITERS, target)
    adapters.refuse_unknown(options, reads | writes, f"--from {kind} --to {target}")
    predictions = adapters.function(adapters.PREDICTIONS, kind)(source, **adapters.given(options, reads))
    remark = adapters.function(adapters.WRITERS, target)(output, predictions, **adapters.given(options, writes))
    if remark:
        click.echo(f"Note: {remark}", err=True)
    hypotheses = sum(len(image.score) for image in predictions.images)
    click.echo(f"{output}: {len(predictions.images)} images, {hypotheses} hypotheses, {predictions.frame} frame")


@click.command(cls=Command)
@click.argument("source", type=FILE)
@click.option("--from", "kind", type=click.Choice(list(adapters.DEPTH_IMAGES)), required=True)
@click.option("-o", "--output", type=FILE, required=True, help="The folder to write.")
@click.option("--camera", type=FILE, help="The camera as JSON, in place of the dataset's.  [icvl]")
@click.option("--sensor", help="Of a set with several sensors, this one, such as cam1.  [bop]")
@click.option("--targets", type=FILE, help="Only the images that test_targets_*.json lists.  [bop]")
def depth(source: Path, kind: str, output: Path, **options: Any) -> None:
    """Write the depth images of SOURCE in one coding, named as in gt.json, with their camera.json.

    16-bit PNG, 0.0001 m a step, 0 = no return. To predict on them:

    \b
    posenet predict MODEL OUTPUT -o preds.json
    """
    from evalkit.adapters.depth_images import DEPTH_UNIT, write_depth_images

    known = adapters.options_of(adapters.DEPTH_IMAGES, kind)
    adapters.refuse_unknown(options, known, f"--from {kind}")
    images = adapters.function(adapters.DEPTH_IMAGES, kind)(source, **adapters.given(options, known))
    counts = write_depth_images(output, images)
    if not counts:
        raise InputError(f"{source}: holds no depth images of the {kind} format; check the path.")
    for folder, count in counts.items():
        click.echo(f"{folder}: {count} depth images, {DEPTH_UNIT:g} m a step, and camera.json")
    suggest_next("posenet", "predict", "MODEL", next(iter(counts)), "--refine", "-o", "preds.json")
