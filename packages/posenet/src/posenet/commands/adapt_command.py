"""`posenet adapt`: a model learns from unlabeled images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evalkit.commands.command import Command
from evalkit.commands.group import suggest_next
from evalkit.commands.image_options import as_typed, image_options, opened
from evalkit.commands.output_file import MODELS, OutputFile
from posenet.commands.log import show_log

if TYPE_CHECKING:
    from posenet.adaptation.adapt import Adapted

FILE = click.Path(path_type=Path)


@click.command(cls=Command)
@click.argument("model", type=FILE)
@click.argument("frames", type=FILE)
@click.option(
    "-o",
    "--output",
    "out",
    type=OutputFile(*MODELS),
    required=True,
    help="The new model's file; MODEL itself is never overwritten.",
)
@click.option("--minutes", type=click.FloatRange(min=0, min_open=True), default=5.0, show_default=True,
              help="Of learning; labeling the images comes on top.")  # fmt: skip
@image_options
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
def adapt(model: Path, frames: Path, out: Path, minutes: float, seed: int, device: str, **options: Any) -> None:
    """Let MODEL learn from FRAMES, unlabeled images of your own camera, and write it as a new model.

    Its refined poses scored at least 0.5 that the images verify (see `evalkit verify`) are the labels; what is unsure
    is left out. A fourth of the frames is held out: where the new model is no better there, by image evidence, the old
    one is written.
    """
    from tqdm import tqdm

    from posenet.adaptation import adapt as adaptation

    adaptation.require_other_file(model, out)
    show_log()
    typed = as_typed(options)
    source = opened(frames, options, "to learn from")
    with tqdm(total=100.0, desc="adapt", bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}") as bar:

        def show(what: str, share: float) -> None:
            bar.set_description_str(what, refresh=False)
            bar.n = 100.0 * share
            bar.refresh()

        found = adaptation.adapt(model, source, out, minutes, device, seed, show)
    click.echo(summary(found, out))
    suggest_next("posenet", "check", out, frames, *typed)


def summary(found: Adapted, out: Path) -> str:
    """What was learned, and which model was kept."""
    lines = [
        f"labels    {', '.join(map(str, found.labels))} verified poses on {found.frames} images, by round",
        *(
            f"{name}  {worth.verified} of {found.parts} parts verified, {worth.wrong} poses wrong, "
            f"F1 {worth.f1(found.parts):.3f}"
            for name, worth in (("old     ", found.before), ("new     ", found.after))
        ),
        f"          (network alone, on {found.held_out} held-out images, by image evidence)",
        f"{out}: the new model" if found.better else f"{out}: the old model, for the new one is no better",
    ]
    return "\n".join(lines)
