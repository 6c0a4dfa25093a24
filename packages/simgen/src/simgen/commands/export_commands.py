"""`simgen export`: shards as a dataset in somebody else's format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from evalkit.commands.group import Commands

FOLDER = click.Path(path_type=Path)


@click.group("export", cls=Commands)
def export_command() -> None:
    """Write shards as a dataset in somebody else's format.

    OUT appears when it is complete; until then its content is in OUT.part, and the same command goes on with it.
    """


@export_command.command("bop")
@click.argument("shards", type=FOLDER)
@click.argument("out", type=FOLDER)
@click.option("--split", default="test", show_default=True, help="Folder for the images, such as train_pbr.")
def bop_command(shards: Path, out: Path, split: str) -> None:
    """A BOP dataset: depth, masks, scene_gt*.json, scene_camera.json, models, targets.

    bop_toolkit reads it when its dataset_params.py knows a set of that name; `evalkit gt --from bop OUT/test` does so.
    """
    from evalkit.errors import InputError
    from simgen.exports.foreign_formats import export_bop, open_whole

    if Path(split).name != split or split.startswith((".", "models")):
        raise InputError(f"--split {split}: give a plain folder name such as test or train_pbr.")
    dataset = open_whole(shards)
    with _bar(len(dataset)) as bar:
        export_bop(dataset, out, split, bar.update)
    click.echo(f"{out}: {_content(dataset)} as the BOP split '{split}'")


@export_command.command("sileane")
@click.argument("shards", type=FOLDER)
@click.argument("out", type=FOLDER)
def sileane_command(shards: Path, out: Path) -> None:
    """An object's folder of the Siléane dataset: gt, depth, segmentation, camera_params.txt, mesh, poseutils.json."""
    from simgen.exports.foreign_formats import export_sileane, open_whole

    dataset = open_whole(shards)
    with _bar(len(dataset)) as bar:
        export_sileane(dataset, out, bar.update)
    click.echo(f"{out}: {_content(dataset)} in Siléane's files")


def _bar(frames: int) -> Any:
    from tqdm import tqdm

    return tqdm(total=frames, desc="export", unit=" frames", disable=None)


def _content(dataset: Any) -> str:
    return f"{len(dataset)} images of {len(set(dataset.scene_index.tolist()))} scenes of {dataset.header.object.title}"
