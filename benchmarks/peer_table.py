"""Rows for classical peers on folders of shards, with the network beside them if it is given.

    python benchmarks/peer_table.py SHARDS ... [--images 8] [--methods PPF PPF+PP] [--model MODEL]

Point pair features (Drost et al. 2010) and Linemod (Hinterstoisser et al. 2011, depth's modality), bare and with
post-processing (ICP, evidence from depth, verification), by OpenCV's contrib modules in an environment of its own,
which the first run makes. What is found is kept in --out: stopped and started again it goes on where it was.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from as_typed import table
from evalkit.commands.group import EXIT_BAD_INPUT, describe_os_error
from evalkit.datasets.documents import GroundTruth, Predictions, read_predictions, write_predictions
from evalkit.datasets.ground_truth import image as labels_of
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.scoring.bootstrap import intervals
from evalkit.scoring.evaluation import average_precision
from peers.methods import METHODS, peer
from posenet.prediction.predictor import Predictor, to_document

NETWORK = ("network", "network, refined")
VISIBILITIES, RESAMPLES = (0.5, 0.3), 1000
TITLES = ["images", "method", *(f"AP >= {v:.0%} [95 %]" for v in VISIBILITIES), "hypotheses", "seconds an image"]


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shards", type=Path, nargs="+")
    parser.add_argument("--images", type=int, default=40, help="of each folder, evenly spread over it")
    parser.add_argument(
        "--methods", nargs="*", default=METHODS, choices=METHODS, metavar="METHOD", help=", ".join(METHODS)
    )
    parser.add_argument("--model", type=Path, help="a trained network, to stand beside them")
    parser.add_argument("--visibility", default="returned", choices=("returned", "geometric"), help="the share")
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/peers"))
    options = parser.parse_args(words)
    if options.images < 1:
        raise InputError(f"--images {options.images}: must be 1 or more.")
    rows = [row for shards in options.shards for row in rows_of(shards, options)]
    print(table(TITLES, rows))


def rows_of(shards: Path, options: argparse.Namespace) -> Iterator[list[str]]:
    """The table's rows about one folder."""
    dataset = ShardDataset(shards)
    frames = spread(len(dataset), options.images)
    truth = truth_of(dataset, frames)
    for method in [*options.methods, *(NETWORK if options.model else ())]:
        model = options.model if method in NETWORK else None
        found = predictions(method, dataset, frames, options.out / shards.name, model)
        cells = []
        for visibility in VISIBILITIES:
            result = average_precision(found, truth, min_visibility=visibility, visibility=options.visibility)
            cells.append(str(intervals(result, RESAMPLES)["ap"]))
        count = np.mean([len(image.score) for image in found.images])
        seconds = seconds_an_image(found)
        row = [f"{shards.name}, {len(frames)}", method, *cells, f"{count:.0f}", f"{seconds:.2f}"]
        print(" | ".join(row), file=sys.stderr, flush=True)
        yield row


def truth_of(dataset: ShardDataset, frames: Sequence[int]) -> GroundTruth:
    return GroundTruth(dataset.header.object, [labels_of(*dataset.locate(f)) for f in frames], share="geometric")


def seconds_an_image(found: Predictions) -> float:
    return float(np.mean([image.time_s or 0.0 for image in found.images]))


def spread(count: int, images: int) -> list[int]:
    """Frames evenly spread over `count`."""
    return [int(frame) for frame in np.unique(np.linspace(0, count - 1, min(images, count)).round())]


def predictions(
    method: str, dataset: ShardDataset, frames: Sequence[int], folder: Path, model: Path | None = None
) -> Predictions:
    """What a peer, or the network in the file or folder `model`, finds on these frames; computed once, then kept."""
    file = folder / f"{method}-{len(frames)}.json"
    if file.exists():
        return read_predictions(file)
    if model is None:
        found = peer(method, dataset, frames, folder)
    else:
        found = by_network(Predictor.load(model, refine="refined" in method), dataset, frames)
    write_predictions(file, found)
    return found


def by_network(predictor: Predictor, dataset: ShardDataset, frames: Sequence[int]) -> Predictions:
    camera = dataset.header.camera
    predictor.predict(dataset[frames[0]].depth, camera)  # compiled and warm before any time is taken
    found = ((dataset[f].image_id, predictor.predict(dataset[f].depth, camera)) for f in frames)
    return to_document(predictor.model, found)


if __name__ == "__main__":
    try:
        main()
    except (InputError, OSError, subprocess.CalledProcessError) as error:
        print(f"Error: {describe_os_error(error) if isinstance(error, OSError) else error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
