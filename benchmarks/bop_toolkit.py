"""`evalkit bop24` beside BOP's own toolkit, run as it is, on simulated estimates: every score to the last digit.

python benchmarks/bop_toolkit.py --toolkit FOLDER [--record figures.json]

FOLDER is a checkout of github.com/thodan/bop_toolkit (MIT), whose scripts run on this Python. Sets are named tudl, as
the toolkit knows sets by name only. tests/benchmarks/test_bop_toolkit.py holds evalkit to the figures recorded here.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop import dataset as bop
from evalkit.adapters.bop import results as bop_results
from evalkit.geometry import poses
from evalkit.meshes.write import write_ply
from evalkit.objects.extent import largest_distance
from evalkit.scoring.detection_ap import detection_ap

Array = NDArray[np.float64]
NAME = "tudl"
SYMMETRIES = ("none", "hexagonal", "revolution")
SEEDS = [0, 1, 2]
HALF_HEIGHT, RADIUS = 30.0, 20.0  # millimeters
K = [572.4, 0.0, 325.3, 0.0, 573.6, 242.0, 0.0, 0.0, 1.0]
SCENES, IMAGES = (1, 2, 3), 4
CROWDED = (2, 1)  # the scene and image that has more estimates than count
WITHOUT = (3, 2)  # shows another object only
OBJECT_ID, OTHER_ID = 1, 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--toolkit", type=Path, required=True, help="a checkout of bop_toolkit")
    parser.add_argument("--record", type=Path, help="add the toolkit's figures to this file")
    parser.add_argument(
        "--offset", type=float, default=0.0, help="mm from the models' origin to their center, where BOP has none (0)"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="one set each, a minute or more (0 1 2)")
    arguments = parser.parse_args()
    worst = 0.0
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory() as folder:
            simulate(Path(folder), seed, arguments.offset)
            theirs, own = by_toolkit(Path(folder), arguments.toolkit.resolve()), by_evalkit(Path(folder))
        if arguments.record is not None:
            record(arguments.record, seed, theirs)
        difference = max(abs(theirs[name] - own[name]) for name in theirs)
        worst = max(worst, difference)
        figures = ", ".join(f"{name} {score:.6f}" for name, score in theirs.items())
        print(f"seed {seed} ({SYMMETRIES[seed % 3]}): {figures}; evalkit differs by at most {difference:.1e}")
    print(f"largest difference: {worst:.1e}")


def record(path: Path, seed: int, scores: dict[str, float]) -> None:
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.write_text(json.dumps(known | {str(seed): scores}, indent=1) + "\n", encoding="utf-8")


def simulate(folder: Path, seed: int, offset: float = 0.0) -> None:
    """Write FOLDER/tudl and FOLDER/results/method_tudl-test.csv: heaps, hidden instances, ties and false alarms.

    Args:
        offset: millimeters from the model's origin to its center; BOP has 0.
    """
    rng, dataset = np.random.default_rng(seed), folder / NAME
    write_models(dataset, SYMMETRIES[seed % len(SYMMETRIES)], offset)
    lines, targets = [",".join(bop_results.COLUMNS)], []
    for scene in SCENES:
        gt: dict[str, Any] = {}
        info: dict[str, Any] = {}
        for image in range(IMAGES):
            instances = heap(rng, offset)
            shown = OTHER_ID if (scene, image) == WITHOUT else OBJECT_ID
            gt[str(image)] = [row_of(pose) | {"obj_id": shown} for pose in instances]
            seen = visibilities(rng, len(instances))
            info[str(image)] = [{"visib_fract": share if shown == OBJECT_ID else 0.0} for share in seen]
            estimates = guesses(rng, instances, 10 if (scene, image) == CROWDED else 2)
            lines += [line_of(scene, image, pose, score) for pose, score in zip(*estimates, strict=True)]
            targets.append({"scene_id": scene, "im_id": image})
        cameras = {str(image): {"cam_K": K, "depth_scale": 0.1} for image in range(IMAGES)}
        for name, document in (("scene_gt", gt), ("scene_gt_info", info), ("scene_camera", cameras)):
            write_json(dataset / "test" / f"{scene:06d}" / f"{name}.json", document)
    write_json(dataset / "test_targets_bop24.json", targets)
    (folder / "results").mkdir()
    (folder / "results" / f"method_{NAME}-test.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_models(dataset: Path, symmetry: str, offset: float) -> None:
    """A prism for every object of the set; a twelve-sided one stands in for a revolution."""
    sides = 12 if symmetry == "revolution" else 6
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    up = np.array([0, 0, HALF_HEIGHT])
    bottom, top = ring - up, ring + up
    if symmetry == "none":
        top[0] *= 1.5
    points = np.concatenate([bottom, top, [-up, up]])
    points -= (points.min(0) + points.max(0)) / 2
    i = np.arange(sides)
    j = (i + 1) % sides
    sheets = [
        (i, j, i + sides),
        (j, j + sides, i + sides),
        (j, i, 0 * i + 2 * sides),
        (i + sides, j + sides, 0 * i + 2 * sides + 1),
    ]
    faces = np.concatenate([np.stack(sheet, -1) for sheet in sheets])
    center = np.array([offset, 0.0, 0.0])
    low, size = points.min(0) + center, np.ptp(points, axis=0)
    info: dict[str, Any] = {"diameter": largest_distance(points)}
    info |= {f"min_{axis}": low[k] for k, axis in enumerate("xyz")} | {
        f"size_{axis}": size[k] for k, axis in enumerate("xyz")
    }
    if symmetry == "hexagonal":
        turns = poses.from_axis_angle([0.0, 0.0, 1.0], np.arange(1, 6) * np.pi / 3)
        motions = poses.from_rotation_translation(turns, center - turns @ center)
        info["symmetries_discrete"] = motions.reshape(-1, 16).tolist()
    if symmetry == "revolution":
        info["symmetries_continuous"] = [{"axis": [0, 0, 1], "offset": center.tolist()}]
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    for obj in (1, 2, 3):
        write_ply(dataset / "models_eval" / f"obj_{obj:06d}.ply", points + center, faces, normals)
    write_json(dataset / "models_eval" / "models_info.json", {str(obj): info for obj in (1, 2, 3)})
    write_json(dataset / "camera.json", {"width": 640, "height": 480, "depth_scale": 0.1})


def heap(rng: np.random.Generator, offset: float) -> Array:
    """cam_from_obj (n, 4, 4) in millimeters of instances so close that estimates might be meant for several."""
    count = 8 + int(9 * rng.random())
    turn = poses.from_axis_angle(rng.random((count, 3)) - 0.5, 3 * rng.random(count))
    center = (rng.random((count, 3)) - 0.5) * [160, 120, 60] + [0, 0, 700]
    return poses.from_rotation_translation(turn, center - turn @ [offset, 0.0, 0.0])


def visibilities(rng: np.random.Generator, count: int) -> list[float]:
    """A third are hidden, a tenth of those just enough to be asked for."""
    seen = rng.random(count)
    return np.where(seen < 0.3, 0.0999 * rng.random(count), np.where(seen < 0.35, 0.1, seen)).tolist()


def guesses(rng: np.random.Generator, instances: Array, each: int) -> tuple[Array, Array]:
    """Estimates (n, 4, 4) from good to wrong, several of an instance, and their scores (n,), many of them equal."""
    near = instances[(rng.random(each * len(instances)) * len(instances)).astype(int)]
    error = rng.random(len(near)) ** 2
    turn = poses.from_axis_angle(rng.random((len(near), 3)) - 0.5, 1.5 * error)
    shift = (rng.random((len(near), 3)) - 0.5) * 60 * error[:, None]
    far = heap(rng, 0.0)[:3]
    moved = np.concatenate([near @ poses.from_rotation_translation(turn, shift), far])
    score = np.round(16 * (1 - 0.7 * np.r_[error, rng.random(len(far))] + 0.3 * rng.random(len(moved)))) / 16
    return moved, score


def row_of(pose: Array) -> dict[str, list[float]]:
    return {"cam_R_m2c": pose[:3, :3].ravel().tolist(), "cam_t_m2c": pose[:3, 3].tolist()}


def line_of(scene: int, image: int, pose: Array, score: float) -> str:
    rotation, translation = (" ".join(map(repr, part.ravel().tolist())) for part in (pose[:3, :3], pose[:3, 3]))
    return f"{scene},{image},{OBJECT_ID},{float(score)!r},{rotation},{translation},-1"


def write_json(path: Path, document: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document), encoding="utf-8")


def by_evalkit(folder: Path) -> dict[str, float]:
    """Our scores of a simulated set."""
    targets = folder / NAME / "test_targets_bop24.json"
    truth = bop.read_ground_truth(folder / NAME / "test", object_id=OBJECT_ID, targets=targets)
    return detection_ap(bop_results.read_predictions(folder / "results" / f"method_{NAME}-test.csv"), truth).scores


def by_toolkit(folder: Path, toolkit: Path) -> dict[str, float]:
    """What the toolkit's script writes of a simulated set."""
    paths = {"BOP_PATH": folder, "BOP_RESULTS_PATH": folder / "results", "BOP_EVAL_PATH": folder / "eval"}
    environment = os.environ | {name: str(path) for name, path in paths.items()} | {"BOP_NUM_WORKERS": "1"}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    environment["PYTHONPATH"] = os.pathsep.join([str(toolkit), environment.get("PYTHONPATH", "")])
    command = [sys.executable, str(toolkit / "scripts" / "eval_bop24_pose.py")]
    command += ["--result_filenames", f"method_{NAME}-test.csv"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"the toolkit failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    scores = json.loads((folder / "eval" / f"method_{NAME}-test" / "scores_bop24.json").read_text(encoding="utf-8"))
    return {name: score for name, score in scores.items() if "mAP" in name}


if __name__ == "__main__":
    main()
