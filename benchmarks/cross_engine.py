"""Does a network trained on one physics engine's piles do as well on the other's? Both ways, several seeds.

    python benchmarks/cross_engine.py [--object bunny] [--scenes 150] [--epochs 8] [--seeds 0,1]

Each engine builds training and test scenes of `--preset demo`; test scenes have a seed of their own, the same for all.
Each pair of engine and seed is one training. Everything is kept in --out: run again, it goes on where it stopped, and
prints the rows that it has. AP is Sym, Siléane protocol, instances at least half visible by geometry.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from as_typed import RESAMPLES, table
from commands import run
from simgen.presets import PHYSICS

TEST_SCENES, TEST_VIEWS, TEST_SEED = 40, 2, 1000
TITLES = ["trained on", "seed", "images", "tested on", "AP alone", "95 %", "AP refined", "95 %"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="bunny", help="mesh file or built-in object")
    parser.add_argument("--scenes", type=int, default=150, help="to train on, of each engine")
    parser.add_argument("--views", type=int, default=8, help="of each")
    parser.add_argument("--test-scenes", type=int, default=TEST_SCENES)
    parser.add_argument("--epochs", type=int, default=8, help="of each training, so that all see as many images")
    parser.add_argument("--seeds", default="0,1", help="of training")
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/cross-engine"))
    options = parser.parse_args()
    for engine in PHYSICS:
        build(options, engine, "train", options.scenes, options.views, 0)
        build(options, engine, "test", options.test_scenes, TEST_VIEWS, TEST_SEED)
        run("evalkit", "gt", options.out / f"test-{engine}", "-o", truth_of(options, engine))
    rows = []
    for seed in map(int, options.seeds.split(",")):
        for trained in PHYSICS:
            model = options.out / f"run-{trained}-{seed}"
            run("posenet", "fit", options.out / f"train-{trained}", "--epochs", options.epochs, "--seed", seed,
                "--no-validation", "-o", model)  # fmt: skip
            rows += [row(options, model, trained, seed, tested) for tested in PHYSICS]
            print("\n" + table(TITLES, rows), flush=True)


def build(options: argparse.Namespace, engine: str, name: str, scenes: int, views: int, seed: int) -> None:
    run("simgen", "build", "--object", options.object, "--preset", "demo", "--physics", engine, "--scenes", scenes,
        "--views", views, "--seed", seed, "--workers", 1, "-o", options.out / f"{name}-{engine}")  # fmt: skip


def row(options: argparse.Namespace, model: Path, trained: str, seed: int, tested: str) -> list[str]:
    """The scores of one network on one engine's test scenes."""
    cells = []
    for kind, refine in (("alone", []), ("refined", ["--refine"])):
        predictions = model / f"on-{tested}-{kind}.json"
        run("posenet", "predict", model, options.out / f"test-{tested}", *refine, "-o", predictions)
        cells += scored(predictions, truth_of(options, tested))
    images = options.epochs * options.scenes * options.views
    return [trained, str(seed), str(images), tested, *cells]


def scored(predictions: Path, truth: Path) -> list[str]:
    """AP and its interval."""
    figures = predictions.with_suffix(".ap.json")
    run("evalkit", "ap", predictions, truth, "--bootstrap", RESAMPLES, "--json", figures)
    found: dict[str, Any] = json.loads(figures.read_text())
    low, high = found["bootstrap"]["ap"]
    return [f"{found['ap']:.3f}", f"{low:.3f} to {high:.3f}"]


def truth_of(options: argparse.Namespace, engine: str) -> Path:
    return Path(options.out / f"gt-{engine}.json")


if __name__ == "__main__":
    main()
