"""The paper's Table 1 on our own data of its objects: classical peers and the network, one cell after the other.

    python benchmarks/table1.py                         # 13 hours or so on 2 CPU cores
    python benchmarks/table1.py --test-scenes 1 --train-scenes 4 --network debug --minutes 0.1   # minutes, to try it

Columns are bunny, cup, pepper and candlestick by Sym, the crowd of cups by ADD and the domestic cup by F1; rows are
Linemod and point pair features, bare and post-processed, the network trained without the offset, the network, and the
network refined. A network learns from scenes of another seed than those it is scored on. Every cell is a file in --out:
stopped in whatever way and started again, the command goes on with the first cell that is missing, and training where
it was. What is finished stays, by whatever version of the code it was made; the table names the versions. A cell that
fails leaves the others to go on, and is tried again the next time.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from as_typed import table
from commands import run
from evalkit.atomic import atomic_path
from evalkit.commands.group import EXIT_BAD_INPUT, describe_os_error
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.json_file import load_json
from evalkit.scoring.bootstrap import intervals
from evalkit.scoring.evaluation import average_precision
from evalkit.scoring.published import OURS, TABLES, WITHOUT_OFFSET, figure
from peer_table import predictions, seconds_an_image, spread, truth_of
from peers.methods import METHODS

TRAIN_SEED, TEST_SEED, TEST_VIEWS, TRAIN_VIEWS, RESAMPLES = 0, 1000, 2, 8, 1000
FAILED = "failed"
NETWORKS = ("network without offset", "network", "network, refined")
ROWS = (*METHODS, *NETWORKS)
PUBLISHED_ROWS = {NETWORKS[0]: WITHOUT_OFFSET, NETWORKS[1]: OURS}  # what the paper calls them
NOTES = """
A cell: the figure with the 95 % interval of resampled scenes, seconds an image, and the published figure in
parentheses. Comparable with the published ones: the criterion, its threshold, the protocol, and which instances are to
be found (at least half visible by what the sensor returned).
Not comparable: images and meshes are ours, simulated, with a simulated sensor, of objects of the same kinds and not the
same shapes; the networks are trained in minutes on a CPU; the cup has a revolution axis, so ADD is taken modulo it
(ADD-S) where the paper says ADD; F1 is the best of the curve where the paper's is at one confidence.
""".strip()


@dataclass(frozen=True)
class Column:
    """One column: the data it is measured on, and the figure.

    Attributes:
        key: of the published table, and `of` its column's name.
    """

    title: str
    mesh: str  # a built-in object
    preset: str
    sensor: str
    criterion: str
    key: str
    of: str

    @property
    def data(self) -> str:
        """The name of its data set, which columns may share."""
        return f"{self.mesh}-{self.preset}"

    def published(self, row: str) -> str:
        """The paper's figure, as it prints it; empty where it has none."""
        known = next(t for t in TABLES if t.key == self.key)
        values = known.rows.get(PUBLISHED_ROWS.get(row, row))
        return "" if values is None else figure(known, values[known.columns.index(self.of)])


COLUMNS = (
    Column("bunny, Sym", "bunny", "sileane", "stereo", "sym", "sym", "bunny"),
    Column("cup, Sym", "cup", "icvl", "kinect", "sym", "sym", "cup"),
    Column("pepper, Sym", "pepper", "sileane", "stereo", "sym", "sym", "pepper"),
    Column("candlestick, Sym", "candlestick", "sileane", "stereo", "sym", "sym", "candlestick"),
    Column("crowd of cups, ADD", "cup", "icvl", "kinect", "adds", "add", "cup, synthetic"),
    Column("domestic cup, F1", "cup", "domestic", "kinect", "adds", "f1", "cup, domestic"),
)


@dataclass(frozen=True)
class Night:
    """The whole table in one folder."""

    out: Path
    test_scenes: int
    train_scenes: int
    network: str
    minutes: float

    def check(self) -> None:
        """That --out holds nothing measured otherwise.

        Raises:
            InputError: it was begun with other numbers.
        """
        mine = {key: value for key, value in asdict(self).items() if key != "out"}
        file = self.out / "table1.json"
        if not file.exists():
            with atomic_path(file) as partial:
                partial.write_text(json.dumps(mine))
        elif load_json(file) != mine:
            raise InputError(f"{file}: begun with {json.dumps(load_json(file))}; give the same, or another --out.")

    def cell(self, column: Column, row: str) -> dict[str, Any]:
        """The figures of one cell, computed if its file is not there."""
        file = self.out / "cells" / f"{column.title} - {row}.json".replace(" ", "_")
        if not file.exists():
            figures = self.measured(column, row) | {"version": code_version()}
            with atomic_path(file) as partial:
                partial.write_text(json.dumps(figures))
        return dict(load_json(file))

    def measured(self, column: Column, row: str) -> dict[str, Any]:
        dataset = ShardDataset(self.shards(column, "test"))
        frames = spread(len(dataset), len(dataset))
        model = self.trained(column, offset=row != NETWORKS[0]) if row in NETWORKS else None
        found = predictions(row, dataset, frames, self.out / column.data, model)
        result = average_precision(found, truth_of(dataset, frames), criterion=column.criterion, visibility="returned")
        interval = intervals(result, RESAMPLES)["best_f1" if column.key == "f1" else "ap"]
        return {
            "value": interval.value,
            "low": interval.low,
            "high": interval.high,
            "images": len(frames),
            "seconds": seconds_an_image(found),
        }

    def shards(self, column: Column, kind: str) -> Path:
        """The shards to train or to test on, built if they are not there."""
        folder = self.out / column.data / kind
        scenes, views, seed = (
            (self.test_scenes, TEST_VIEWS, TEST_SEED)
            if kind == "test"
            else (self.train_scenes, TRAIN_VIEWS, TRAIN_SEED)
        )
        self.once(folder, "simgen", "build", "--object", column.mesh, "--preset", column.preset, "--sensor",
                  column.sensor, "--scenes", scenes, "--views", views, "--seed", seed, "-o", folder)  # fmt: skip
        return folder

    def trained(self, column: Column, offset: bool) -> Path:
        """A run's folder, trained as far as it was not."""
        folder = self.out / column.data / ("with-offset" if offset else "without-offset")
        self.once(folder, "posenet", "fit", self.shards(column, "train"), "--preset", self.network, "--minutes",
                  self.minutes, "--offset" if offset else "--no-offset", "-o", folder)  # fmt: skip
        return folder

    def once(self, folder: Path, *words: object) -> None:
        """Run a command that fills `folder`, unless it has done so: another version of the code would begin anew."""
        done = self.out / "done" / f"{folder.parent.name} {folder.name}".replace(" ", "_")
        if not done.exists():
            run(*map(str, words))
            with atomic_path(done) as partial:
                partial.write_text(code_version())

    def table(self, columns: list[Column], rows: list[str]) -> Iterator[list[str]]:
        """The lines; a cell whose commands fail is said to have failed."""
        for row in rows:
            line = [row]
            for column in columns:
                try:
                    line.append(shown(self.cell(column, row), column.published(row)))
                except (InputError, OSError, subprocess.CalledProcessError) as error:
                    print(
                        f"Error: {describe_os_error(error) if isinstance(error, OSError) else error}", file=sys.stderr
                    )
                    line.append(FAILED)
                print(f"{column.title} | {row} | {line[-1]}", flush=True)
            yield line

    def versions(self) -> list[str]:
        """Of the code that measured the cells."""
        return sorted({load_json(file).get("version", "unknown") for file in (self.out / "cells").glob("*.json")})


def code_version() -> str:
    """The commit, marked where files differ from it, or without git the release."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return version("binpose-evalkit")


def sentence(error: Exception) -> str:
    return describe_os_error(error) if isinstance(error, OSError) else str(error)


def shown(cell: dict[str, Any], published: str) -> str:
    text = f"{cell['value']:.3f} [{cell['low']:.3f}, {cell['high']:.3f}], {cell['seconds']:.2g} s"
    return f"{text} ({published})" if published else text


def main(words: list[str] | None = None) -> None:
    titles = [column.title for column in COLUMNS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/table1"))
    parser.add_argument("--test-scenes", type=int, default=20, help="of two views each")
    parser.add_argument("--train-scenes", type=int, default=500)
    parser.add_argument("--network", default="small", help="preset of posenet fit")
    parser.add_argument("--minutes", type=float, default=35.0, help="of each of ten trainings")
    parser.add_argument(
        "--columns", nargs="*", default=titles, choices=titles, metavar="COLUMN", help="; ".join(titles)
    )
    parser.add_argument("--rows", nargs="*", default=ROWS, choices=ROWS, metavar="ROW", help="; ".join(ROWS))
    options = parser.parse_args(words)
    night = Night(options.out, options.test_scenes, options.train_scenes, options.network, options.minutes)
    night.check()
    columns = [column for column in COLUMNS if column.title in options.columns]
    rows = [row for row in ROWS if row in options.rows]
    lines = list(night.table(columns, rows))
    images = f"{TEST_VIEWS * options.test_scenes} images a cell, networks trained {options.minutes:g} minutes."
    made = f"Measured by the code of {', '.join(night.versions())}."
    text = f"{table(['method', *(column.title for column in columns)], lines)}\n\n{images} {made}\n{NOTES}\n"
    with atomic_path(options.out / "table1.md") as partial:
        partial.write_text(text)
    print(f"\n{text}\nWritten to {options.out / 'table1.md'}.")
    missing = sum(line.count(FAILED) for line in lines)
    if missing:
        raise InputError(f"{missing} cells failed, for the reasons above; run the same command again to try them.")


if __name__ == "__main__":
    try:
        main()
    except (InputError, OSError) as error:
        print(f"Error: {sentence(error)}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
