"""One row of RESULTS.md: an object, a sensor, minutes of training; AP on scenes never trained on, alone and refined.

    python benchmarks/accuracy.py --object bunny --sensor stereo --minutes 60 --deep-scenes 160 --augment-noise 0.01

Options that it does not know go to `posenet fit`. Everything is kept in --out and continued from there: run again,
finished steps take seconds. AP is Sym, Siléane protocol; the test scenes have another seed than the training scenes and
are scored once a row.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from commands import run

TRAIN_SEED, TEST_SEED = 0, 1000
VISIBILITIES = (0.5, 0.3)
DEEP_DISTANCE = "0.54-0.9x"  # of that at which the bin fits the image: heaps cut by its frame
COLUMNS = [
    "object",
    "sensor",
    "test",
    "minutes",
    "images",
    "visible (geometric)",
    "AP alone",
    "AP refined",
    "ms alone",
    "ms refined",
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="bunny", help="mesh file or built-in object")
    parser.add_argument("--sensor", default="stereo", choices=("ideal", "stereo", "kinect"))
    parser.add_argument("--minutes", type=float, default=60.0, help="of training")
    parser.add_argument("--preset", default="small", help="of posenet")
    parser.add_argument("--scenes", type=int, default=640, help="of simgen's preset demo, to train on")
    parser.add_argument("--views", type=int, default=12, help="of each")
    parser.add_argument(
        "--deep-scenes", type=int, default=0, help="and so many of preset sileane, with the same camera"
    )
    parser.add_argument("--test-scenes", type=int, default=40, help="two views each")
    parser.add_argument("--layouts", type=Path, help="folder in Siléane's format: its scenes are a second test set")
    parser.add_argument("--seed", type=int, default=TRAIN_SEED)
    parser.add_argument("-o", "--output", dest="out", type=Path, help="[runs/accuracy/OBJECT-SENSOR-MINUTES]")
    options, fit = parser.parse_known_args()
    out = options.out or Path("runs") / "accuracy" / f"{Path(options.object).stem}-{options.sensor}-{options.minutes:g}"
    model = trained(options, fit, out)
    rows = [row for name in tests(options, out) for row in scored(options, model, out, name)]
    for row in [COLUMNS, ["---"] * len(COLUMNS), *rows]:
        print("| " + " | ".join(row) + " |")


def trained(options: argparse.Namespace, fit: list[str], out: Path) -> Path:
    """Build the training scenes and train on them; the run's folder."""
    heaps, deep, model = out / "heaps", out / "deep", out / "run"
    build(options, "demo", "--scenes", options.scenes, "--views", options.views, "--seed", options.seed, "-o", heaps)
    if options.deep_scenes:
        camera = out / "camera.json"
        camera.write_text(json.dumps(json.loads((heaps / "dataset.json").read_text())["camera"]))
        build(options, "sileane", "--camera", camera, "--distance", DEEP_DISTANCE, "--scenes", options.deep_scenes,
              "--views", 10, "--seed", options.seed, "-o", deep)  # fmt: skip
    folders = [heaps, deep] if options.deep_scenes else [heaps]
    run("posenet", "fit", *folders, "--preset", options.preset, "--minutes", options.minutes, "--seed", options.seed,
        *fit, "-o", model)  # fmt: skip
    return model


def tests(options: argparse.Namespace, out: Path) -> list[str]:
    """Build the test images; the names of their folders."""
    build(options, "demo", "--scenes", options.test_scenes, "--views", 2, "--seed", TEST_SEED, "-o", out / "test")
    if not options.layouts:
        return ["test"]
    run("simgen", "render", options.layouts, "--sensor", options.sensor, "-o", out / "layouts")
    return ["test", "layouts"]


def build(options: argparse.Namespace, preset: str, *rest: object) -> None:
    run("simgen", "build", "--object", options.object, "--sensor", options.sensor, "--preset", preset, *rest)


def scored(options: argparse.Namespace, model: Path, out: Path, name: str) -> list[list[str]]:
    """Predict on the shards in `out / name` and score: a row for each visibility from which instances count."""
    shards, truth = out / name, out / f"{name}-gt.json"
    run("evalkit", "gt", shards, "-o", truth)
    found = {kind: out / f"{name}-{kind}.json" for kind in ("alone", "refined")}
    for kind, file in found.items():
        run("posenet", "predict", model, shards, *(["--refine"] if kind == "refined" else []), "-o", file,
            "--picture", file.with_suffix(".png"))  # fmt: skip
    images = str(json.loads((model / "metrics.jsonl").read_text().splitlines()[-1])["images"])
    start = [options.object, options.sensor, name, f"{options.minutes:g}", images]
    times = [f"{milliseconds(file):.0f}" for file in found.values()]
    return [
        [*start, f">= {visibility:.0%}", *(ap(file, truth, visibility) for file in found.values()), *times]
        for visibility in VISIBILITIES
    ]


def ap(predictions: Path, truth: Path, visibility: float) -> str:
    figures = predictions.with_name(f"{predictions.stem}-{visibility:g}-ap.json")
    run("evalkit", "ap", predictions, truth, "--min-visibility", visibility, "--json", figures)
    return f"{json.loads(figures.read_text())['ap']:.3f}"


def milliseconds(predictions: Path) -> float:
    """Median time an image."""
    document: dict[str, Any] = json.loads(predictions.read_text())
    times = sorted(image["time_s"] for image in document["images"])
    return 1e3 * times[len(times) // 2]


if __name__ == "__main__":
    main()
