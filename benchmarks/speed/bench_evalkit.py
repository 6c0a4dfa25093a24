"""How fast evalkit scores: the reference scenes against the plain protocol, one command, and a million hypotheses.

python benchmarks/speed/bench_evalkit.py [--images 34000]
"""

from __future__ import annotations

import argparse
import os
import runpy
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit import (
    GroundTruth,
    GroundTruthImage,
    PredictionImage,
    Predictions,
    average_precision,
    read_ground_truth,
    read_predictions,
    write_ground_truth,
    write_predictions,
)
from evalkit.adapters.sileane import dataset as sileane
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym, SymToolbox

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = Path(os.environ.get("BINPOSE_REFERENCE", ROOT.parent / "shared" / "reference"))
INSTANCES, HYPOTHESES, FALSE_ALARMS = 15, 30, 8  # an image
ENOUGH_S = 0.5  # a measurement repeats until it has lasted so long


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=34_000, help=f"of {HYPOTHESES} hypotheses each (34,000)")
    images = parser.parse_args().images
    with tempfile.TemporaryDirectory() as folder:
        bench_reference_scenes(Path(folder))
        bench_crowd(Path(folder), images)


def bench_reference_scenes(folder: Path) -> None:
    """The three Siléane scenes: read and scored, by us and by the plain reference; and the command as a process."""
    source = REFERENCE / "sileane_bunny"
    if not source.is_dir():
        print(f"no reference data at {REFERENCE}: set BINPOSE_REFERENCE to time its scenes")
        return
    truth, predictions = sileane.read_ground_truth(source), sileane.read_predictions(source / "results")
    gt, preds = folder / "gt.json", folder / "preds.json"
    write_ground_truth(gt, truth)
    write_predictions(preds, predictions)
    fast = seconds(lambda: average_precision(predictions, truth))
    report("3 reference scenes, scored", fast)
    report(
        "3 reference scenes, read and scored",
        seconds(lambda: average_precision(read_predictions(preds), read_ground_truth(gt))),
    )
    plain = seconds(lambda: score_plainly(predictions, truth))
    report(f"the plain reference protocol ({plain / fast:.0f} times ours)", plain)
    report("`evalkit ap` as a process", seconds(lambda: evalkit_ap(preds, gt)))
    compare_toolbox(source)
    print()


def compare_toolbox(folder: Path) -> None:
    """How far the toolbox's reading of the Sym distance is from the right one, on the Siléane bunny."""
    truth, predictions = sileane.read_ground_truth(folder), sileane.read_predictions(folder / "results")
    rng = np.random.default_rng(0)
    nowhere = np.zeros((100_000, 3))
    one = poses.from_rotation_translation(poses.random_rotations(rng, len(nowhere)), nowhere)
    print("\nSym on the Siléane bunny, right and as its toolbox reads it")
    for degrees in (5, 20, 90, 180):
        turn = poses.from_axis_angle(rng.normal(size=nowhere.shape), np.radians(degrees))
        other = one @ poses.from_rotation_translation(turn, nowhere)
        right, toolbox = 1000 * Sym(truth.object)(one, other), 1000 * SymToolbox(truth.object)(one, other)
        print(
            f"{degrees:>4} degrees apart: {right.mean():6.2f} mm, off by up to {np.abs(right - toolbox).max():.2f} mm"
        )
    for threshold in (0.1, 0.025, 0.015, 0.01, 0.005):
        right_ap, toolbox_ap = (
            average_precision(predictions, truth, protocol=protocol, threshold=threshold).ap
            for protocol in ("sileane", "sileane-toolbox")
        )
        print(f"AP at {threshold:5g} diameters: {right_ap:.4f}, toolbox {toolbox_ap:.4f}")


def bench_crowd(folder: Path, images: int) -> None:
    """Many images of random poses: in memory, and from files in a process whose memory is measured."""
    predictions, truth = crowd(images)
    count = f"{images * HYPOTHESES:,} hypotheses, {images:,} images"
    for protocol in ("sileane", "coco"):
        start = time.perf_counter()
        average_precision(predictions, truth, protocol=protocol)
        report(f"{count}, {protocol}", time.perf_counter() - start)
    gt, preds = folder / "crowd_gt.json", folder / "crowd_preds.json"
    write_ground_truth(gt, truth)
    write_predictions(preds, predictions)
    start = time.perf_counter()
    peak_gb = evalkit_ap(preds, gt)
    size_mb = (gt.stat().st_size + preds.stat().st_size) / 1e6
    report(
        f"{count}, `evalkit ap` on {size_mb:.0f} MB of JSON", time.perf_counter() - start, f", peak {peak_gb:.2f} GB"
    )


def crowd(images: int, seed: int = 0) -> tuple[Predictions, GroundTruth]:
    """Images of 15 instances and 30 hypotheses: 22 near an instance, 8 anywhere."""
    rng = np.random.default_rng(seed)
    model = ObjectModel.from_mesh("bar", *box(0.1, 0.05, 0.02))
    truth = random_poses(rng, images, INSTANCES)
    chosen = rng.integers(0, INSTANCES, (images, HYPOTHESES - FALSE_ALARMS))
    motion = poses.from_rotation_translation(
        poses.from_axis_angle(rng.normal(size=(*chosen.shape, 3)), rng.exponential(0.2, chosen.shape)),
        rng.normal(0, 0.003, (*chosen.shape, 3)),
    )
    near = np.take_along_axis(truth, chosen[..., None, None], 1) @ motion
    hypotheses = np.concatenate([near, random_poses(rng, images, FALSE_ALARMS)], 1)
    score, visibility = rng.random((images, HYPOTHESES)), rng.random((images, INSTANCES))
    names = [f"{number:06d}-000" for number in range(images)]
    return (
        Predictions("bar", [PredictionImage(*parts) for parts in zip(names, hypotheses, score, strict=True)]),
        GroundTruth(model, [GroundTruthImage(n, None, p, v) for n, p, v in zip(names, truth, visibility, strict=True)]),
    )


def random_poses(rng: np.random.Generator, images: int, count: int) -> NDArray[np.float64]:
    rotation = poses.random_rotations(rng, images * count).reshape(images, count, 3, 3)
    return poses.from_rotation_translation(rotation, rng.uniform(-0.2, 0.2, (images, count, 3)) + np.array([0, 0, 1.0]))


def box(*sides: float) -> tuple[list[list[float]], list[tuple[int, int, int]]]:
    """Vertices and faces of a box about the origin."""
    x, y, z = (side / 2 for side in sides)
    vertices = [[sx * x, sy * y, sz * z] for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return vertices, [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]


def score_plainly(predictions: Predictions, truth: GroundTruth) -> float:
    plain = runpy.run_path(str(ROOT / "tests" / "evalkit" / "reference_protocol.py"))
    found = {image.id: image for image in predictions.images}
    scenes = [
        (
            list(zip(found[image.id].cam_from_obj, found[image.id].score.tolist(), strict=True)),
            list(zip(image.cam_from_obj, image.visibility >= 0.5, strict=True)),
        )
        for image in truth.images
    ]
    model = truth.object
    return float(plain["evaluate"](scenes, lambda a, b: plain["sym_distance"](a, b, model), model.threshold)["ap"])


def evalkit_ap(preds: Path, gt: Path) -> float:
    """Run the command; its peak memory in GB."""
    command = [str(Path(sys.executable).with_name("evalkit")), "ap", str(preds), str(gt)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} failed")
    return usage.ru_maxrss / 1e6


def seconds(run: Callable[[], object]) -> float:
    """The best of as many runs as fit into half a second, three at the least."""
    taken: list[float] = []
    while len(taken) < 3 or sum(taken) < ENOUGH_S:
        start = time.perf_counter()
        run()
        taken.append(time.perf_counter() - start)
    return min(taken)


def report(what: str, duration: float, rest: str = "") -> None:
    figure = f"{1000 * duration:.1f} ms" if duration < 1 else f"{duration:.1f} s"
    print(f"{what:<72} {figure:>10}{rest}", flush=True)


if __name__ == "__main__":
    main()
