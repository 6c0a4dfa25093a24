"""What bfloat16 layers cost: the same networks on the same images, by --precision float32 and bfloat16.

    python benchmarks/precision.py SHARDS ... --models MODEL ... [--refined 100]

One model a folder of shards, in that order. Poses alone are compared on all images, refined ones on some of them; the
difference has the interval of `evalkit compare`, as both are of the same scenes. AP is Sym, Siléane protocol, geometric
share. What is predicted is kept in --out: stopped and started again it goes on where it was.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from as_typed import table
from evalkit.commands.group import EXIT_BAD_INPUT, describe_os_error
from evalkit.datasets.documents import Predictions, read_predictions, write_predictions
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.scoring.bootstrap import compare
from evalkit.scoring.evaluation import average_precision
from peer_table import by_network, seconds_an_image, spread, truth_of
from posenet.prediction.predictor import Predictor

PRECISIONS = ("float32", "bfloat16")
VISIBILITIES, RESAMPLES = (0.5, 0.3), 1000
TITLES = ["model", "poses", "images", "visible", *(f"AP {p}" for p in PRECISIONS), "difference [95 %]", "ms an image"]


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shards", type=Path, nargs="+")
    parser.add_argument("--models", type=Path, nargs="+", required=True, help="a trained network for each folder")
    parser.add_argument("--images", type=int, default=400, help="of each folder, evenly spread over it (400)")
    parser.add_argument("--refined", type=int, default=100, help="of these, images to refine as well (100)")
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/precision"))
    options = parser.parse_args(words)
    if len(options.models) != len(options.shards):
        raise InputError(
            f"{len(options.models)} models for {len(options.shards)} folders of shards; give one for each."
        )
    rows = [
        row
        for shards, model in zip(options.shards, options.models, strict=True)
        for refine, images in ((False, options.images), (True, options.refined))
        if images > 0
        for row in rows_of(ShardDataset(shards), shards.name, model, refine, images, options.out)
    ]
    print(table(TITLES, rows))


def rows_of(dataset: ShardDataset, name: str, model: Path, refine: bool, images: int, out: Path) -> Iterator[list[str]]:
    """The table's rows about one network, alone or refined."""
    frames, kind = spread(len(dataset), images), "refined" if refine else "alone"
    truth, found = truth_of(dataset, frames), dict[str, Predictions]()
    for precision in PRECISIONS:
        file = out / f"{name}-{kind}-{len(frames)}-{precision}.json"
        if not file.exists():
            out.mkdir(parents=True, exist_ok=True)
            predictor = Predictor.load(model, refine=refine, precision=precision)
            write_predictions(file, by_network(predictor, dataset, frames))
        found[precision] = read_predictions(file)
    milliseconds = ", ".join(f"{1000 * seconds_an_image(found[precision]):.0f}" for precision in PRECISIONS)
    for visibility in VISIBILITIES:
        exact, coarse = (average_precision(found[p], truth, min_visibility=visibility) for p in PRECISIONS)
        both = (f"{result.ap:.4f}" for result in (exact, coarse))
        gain = compare(exact, coarse, RESAMPLES).difference
        difference = f"{gain.value:+.4f} [{gain.low:+.4f}, {gain.high:+.4f}]"
        row = [name, kind, str(len(frames)), f">= {visibility:.0%}", *both, difference, milliseconds]
        print(" | ".join(row), file=sys.stderr, flush=True)
        yield row


if __name__ == "__main__":
    try:
        main()
    except (InputError, OSError) as error:
        print(f"Error: {describe_os_error(error) if isinstance(error, OSError) else error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
