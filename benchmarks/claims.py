"""What the paper's choices are worth on our data: one table, the same images and passes for every row.

    python benchmarks/claims.py --object bunny --sensor stereo --epochs 1 [--table registration --seeds 3]

Sock et al. (BMVC 2018) claim that each of these gains: the offset network, several hypotheses, joint registration, and
learning all tasks together. Everything is kept in --out and continued from there. AP is Sym, Siléane protocol, on
scenes of another seed, of instances at least half visible (geometric); of the tasks, the median errors on the true
boxes of instances with half of them returned; of registration, AP with it less AP of the same network without, with the
interval of `evalkit compare`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from accuracy import TEST_SEED, TRAIN_SEED, ap
from commands import run
from posenet.config import TASKS
from posenet.models.model_file import load_model
from posenet.network import hypotheses
from posenet.network.pose_network import PoseNetwork
from posenet.training.dataset import Frames

TRAININGS: dict[str, tuple[str, ...]] = {
    "small": (),
    "no-offset": ("--no-offset",),
    "seeing": ("--registration-cells", "4"),
    "product": ("--confidence", "product"),
    "product-seeing": ("--confidence", "product", "--registration-cells", "4"),
    "printed-weights": ("--registration-weights", "paper"),
    **{f"only-{task}": ("--tasks", task) for task in TASKS},
}
ROWS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("as it is", "small", ()),
    ("one hypothesis a detection, not five", "small", ("--hypotheses", "1")),
    ("trained without the offset", "no-offset", ()),
    ("without registration", "small", ("--no-registration",)),
    ("scores are the marginals' product", "product", ("--no-registration",)),
    ("the product, registered", "product", ()),
    ("registration sees the image too", "seeing", ()),
    ("the product, registered by one that sees the image", "product-seeing", ()),
    ("registration's weights as the paper prints them", "printed-weights", ()),
)
REGISTERED = {
    "the learned confidence; hears relations": "small",
    "the learned confidence; hears relations and the image": "seeing",
    "the product; hears relations": "product",
    "the product; hears relations and the image": "product-seeing",
}
TABLES = ("scores", "tasks", "registration")
LEAST_VISIBILITY = 0.5
VISIBILITIES = (0.5, 0.3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="bunny", help="mesh file or built-in object")
    parser.add_argument("--sensor", default="stereo", choices=("ideal", "stereo", "kinect"))
    parser.add_argument("--epochs", type=int, default=1, help="passes over the training images, for each training")
    parser.add_argument("--preset", default="small", help="of posenet")
    parser.add_argument("--data", default="demo", help="preset of simgen")
    parser.add_argument("--scenes", type=int, default=640)
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--test-scenes", type=int, default=40, help="two views each")
    parser.add_argument("--table", choices=TABLES, action="append", help="only this one; may be repeated")
    parser.add_argument("--seeds", type=int, default=1, help="of training, for the table of registration")
    parser.add_argument("-o", "--output", dest="out", type=Path, help="[runs/claims/OBJECT-SENSOR-EPOCHS]")
    options = parser.parse_args()
    out = options.out or Path("runs") / "claims" / f"{Path(options.object).stem}-{options.sensor}-{options.epochs}"
    build(options, out)
    tables = options.table or TABLES
    if {"scores", "tasks"} & set(tables):
        for name in TRAININGS:
            fit(options, out, name)
    made = {
        "scores": lambda: score_table(out),
        "tasks": lambda: task_table(out),
        "registration": lambda: registration_table(options, out),
    }
    for name in tables:
        print("\n".join([*made[name](), ""]))


def fit(options: argparse.Namespace, out: Path, name: str, seed: int = 0) -> Path:
    """The folder of one of TRAININGS, called `name` if its seed is 0."""
    folder = out / (f"{name}-seed{seed}" if seed else name)
    run("posenet", "fit", out / "train", "--preset", options.preset, "--epochs", options.epochs, "--seed", seed,
        *TRAININGS[name], "-o", folder)  # fmt: skip
    return folder


def build(options: argparse.Namespace, out: Path) -> None:
    sets = {"train": (options.scenes, options.views, TRAIN_SEED), "test": (options.test_scenes, 2, TEST_SEED)}
    for name, (scenes, views, seed) in sets.items():
        run("simgen", "build", "--object", options.object, "--sensor", options.sensor, "--preset", options.data,
            "--scenes", scenes, "--views", views, "--seed", seed, "-o", out / name)  # fmt: skip
    run("evalkit", "gt", out / "test", "-o", out / "gt.json")


def score_table(out: Path) -> Iterator[str]:
    """AP of each row, alone and refined."""
    yield "| | images trained on | AP alone | AP refined |"
    yield "|---|---|---|---|"
    for number, (title, training, words) in enumerate(ROWS):
        cells = []
        for kind, refine in (("alone", ()), ("refined", ("--refine",))):
            found = out / f"{number}-{kind}.json"
            run("posenet", "predict", out / training, out / "test", *words, *refine, "-o", found)
            cells.append(ap(found, out / "gt.json", LEAST_VISIBILITY))
        images = json.loads((out / training / "metrics.jsonl").read_text().splitlines()[-1])["images"]
        yield f"| {title} | {images} | {' | '.join(cells)} |"


def registration_table(options: argparse.Namespace, out: Path) -> Iterator[str]:
    """What registration adds to the very network that it was trained with."""
    yield "| registration over | seed | visible | AP without | AP with | difference [95 %] |"
    yield "|---|---|---|---|---|---|"
    for title, name in REGISTERED.items():
        for seed in range(options.seeds):
            model = fit(options, out, name, seed)
            without, registered = (out / f"{model.name}-{kind}.json" for kind in ("without", "with"))
            run("posenet", "predict", model, out / "test", "--no-registration", "-o", without)
            run("posenet", "predict", model, out / "test", "-o", registered)
            for visibility in VISIBILITIES:
                figures = paired(without, registered, out / "gt.json", visibility)
                yield f"| {title} | {seed} | >= {visibility:.0%} | {figures} |"


def paired(first: Path, second: Path, truth: Path, visibility: float) -> str:
    """AP of both and the difference with its interval, as cells of a row."""
    figures = second.with_name(f"{second.stem}-{visibility:g}-compared.json")
    run("evalkit", "compare", first, second, truth, "--min-visibility", visibility, "--json", figures)
    outcome = json.loads(figures.read_text())
    difference = outcome["difference"]
    return (
        f"{outcome['first']['value']:.3f} | {outcome['second']['value']:.3f} | "
        f"{difference['value']:+.3f} [{difference['low']:+.3f}, {difference['high']:+.3f}]"
    )


def task_table(out: Path) -> Iterator[str]:
    """Median errors of each task, learned with the others and on its own."""
    yield "| | center, px | depth, mm | rotation, Sym mm |"
    yield "|---|---|---|---|"
    together = task_errors(out / "small", out / "test")
    apart = [task_errors(out / f"only-{task}", out / "test")[i] for i, task in enumerate(TASKS)]
    for title, errors in (("learned together", together), ("each in a network of its own", apart)):
        yield f"| {title} | " + " | ".join(f"{error:.2f}" for error in errors) + " |"


@torch.no_grad()
def task_errors(model: Path, shards: Path) -> list[float]:
    """Median errors of center (pixels), depth (mm) and rotation (Sym, mm) on the true boxes, in the order of TASKS."""
    network = load_model(model, torch.device("cpu")).network.eval()
    frames = Frames(shards)
    found = [
        _errors(network, frames, number) for number in tqdm(range(len(frames.dataset)), desc=model.name, disable=None)
    ]
    return [float(torch.cat(part).median()) for part in zip(*found, strict=True)]


def _errors(network: PoseNetwork, frames: Frames, number: int) -> tuple[Tensor, Tensor, Tensor]:
    """Errors (n,) of one image's instances."""
    batch = frames.batch(np.array([number]))
    seen = batch.visibility[0] >= LEAST_VISIBILITY
    boxes, truth = batch.boxes[0][seen], batch.poses[0][seen]
    images = network.encode(batch.depth, batch.intrinsics)
    regions = network.regions(images, boxes, torch.zeros(len(boxes), dtype=torch.long))
    regions, truth = regions.select(regions.valid), truth[regions.valid]
    outputs = network.read(images, regions)
    labels = network.codec.encode(truth, regions.windows, regions.reference_depth, regions.intrinsics)
    sides = regions.windows[:, 2:] - regions.windows[:, :2]
    center = ((outputs.offset - labels.offset) * sides).norm(dim=1)
    best = hypotheses.generate(outputs, regions, network.codec, network.distance, 1)
    turned = network.distance.rotation_squared(best.relative, labels.rotation).sqrt()
    return center, 1e3 * (best.depth - labels.depth).abs(), 1e3 * turned


if __name__ == "__main__":
    main()
