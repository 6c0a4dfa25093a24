"""Two parts in one bin, two models on each image: does a model take the other part for its own?

Both apart, and together, so that poses of both compete for what the image shows (`posenet predict --also`).

    python benchmarks/kitting.py gear.stl cup.stl --models gear.pt cup.pt
    python benchmarks/kitting.py gear.stl cup.stl --models gear.pt cup.pt --scenes-files gears.h5 cups.h5

Two sets of images: bins of the first part with the second among it, and the reverse, of seeds that no training saw.
The labels of a set are those of one part. A pose (refined, scored at least 0.5) of that part's model is right within
the Sym threshold of an instance; a pose of the other part's model lies on the labeled part where more than half of the
pixels that agree with it (of its silhouette, where hardly any does) belong to one of its instances.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from as_typed import table
from commands import run
from evalkit.datasets.documents import PredictionImage, read_predictions
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.evidence.ray_tracer import RayTracer
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym
from posenet.models.model_file import load_model

SEEDS = (1012, 1013)
MIN_SCORE, SHARE = 0.5, 0.4
TOLERANCE = 0.035  # diameters within which depth agrees
FEWEST = 40  # pixels that agree; where fewer do, the whole silhouette says what a pose lies on


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", type=Path, nargs=2, help="meshes of both parts")
    parser.add_argument("--models", type=Path, nargs=2, required=True, help="of both parts, in the same order")
    parser.add_argument("--scenes-files", type=Path, nargs=2, help="of simgen simulate, in place of scenes made here")
    parser.add_argument("--sensor", default="stereo")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/kitting"))
    options = parser.parse_args()
    rows = []
    for number, part in enumerate(options.parts):
        other = options.parts[1 - number]
        test = options.out / f"test-{part.stem}"
        scenes = None if options.scenes_files is None else options.scenes_files[number]
        build(part, other, scenes, SEEDS[number], options, test)
        name, sets = f"{part.stem}, {other.stem} among it", predicted(test, part, options)
        for how, files in sets.items():
            for turn, (model, preds) in enumerate(zip(options.models, files, strict=True)):
                rows.append([name, model.stem, how, *judged(test, preds, model, turn == number)])
    heads = [
        "bin of",
        "model",
        "models",
        "images",
        f"poses >= {MIN_SCORE}",
        "right",
        "on the other part",
        "highest score there",
    ]
    print(table(heads, rows))


def predicted(test: Path, part: Path, options: argparse.Namespace) -> dict[str, list[Path]]:
    """A preds.json of each model, apart and together."""
    apart = [options.out / f"{model.stem}-on-{part.stem}.json" for model in options.models]
    for model, preds in zip(options.models, apart, strict=True):
        run("posenet", "predict", model, test, "--refine", "-o", preds)
    together = options.out / f"together-on-{part.stem}.json"
    first, second = options.models
    run("posenet", "predict", first, test, "--also", second, "-o", together)
    beside = next(file for file in options.out.glob(f"{together.stem}-*.json"))
    return {"apart": apart, "together": [together, beside]}


def build(part: Path, other: Path, scenes: Path | None, seed: int, options: argparse.Namespace, test: Path) -> None:
    """A set of images of `part` with `other` among it."""
    if scenes is not None:
        run("simgen", "render", scenes, "--sensor", options.sensor, "-o", test)
        return
    run("simgen", "build", "--object", part, "--distractors", other, "--share", SHARE, "--sensor", options.sensor,
        "--scenes", options.scenes, "--views", options.views, "--seed", seed, "-o", test)  # fmt: skip


def judged(test: Path, preds: Path, model: Path, own: bool) -> list[str]:
    """Cells of the row of a model's poses on a set whose labels are of its own part, or of the other one."""
    known = load_model(model).network.model
    views = {view.image_id: view for view in ShardDataset(test)}
    images = read_predictions(preds).images
    poses = sum(int((image.score >= MIN_SCORE).sum()) for image in images)
    if own:
        right = sum(right_poses(image, views[image.id], known) for image in images)
        return [str(len(images)), str(poses), str(right), "", ""]
    scores = np.concatenate([scores_on_labeled(image, views[image.id], known) for image in images])
    highest = f"{scores.max():.3f}" if len(scores) else "none"
    return [str(len(images)), str(poses), "", str(int((scores >= MIN_SCORE).sum())), highest]


def right_poses(image: PredictionImage, view: View, model: ObjectModel) -> int:
    """How many poses scored high enough lie within the threshold of an instance."""
    sure = image.cam_from_obj[image.score >= MIN_SCORE]
    there, sym = view.instances.cam_from_obj, Sym(model)
    return sum(bool(sym(np.repeat(pose[None], len(there), 0), there).min() <= model.threshold) for pose in sure)


def scores_on_labeled(image: PredictionImage, view: View, model: ObjectModel) -> NDArray[np.float64]:
    """Scores of the poses of `model` that lie on instances which the view labels."""
    tracer = RayTracer(model)
    found = [lies_on_labeled(tracer, pose, view, TOLERANCE * model.diameter) for pose in image.cam_from_obj]
    return np.asarray(image.score, float)[np.array(found, bool)]


def lies_on_labeled(tracer: RayTracer, cam_from_obj: NDArray[np.float64], view: View, tolerance: float) -> bool:
    traced = tracer.trace(cam_from_obj, view.camera)
    agrees = np.abs(view.depth[traced.v, traced.u] - traced.depth) <= tolerance
    labeled = view.instance_id[traced.v, traced.u] > 0
    of = labeled[agrees] if agrees.sum() * traced.stride**2 >= FEWEST else labeled
    return bool(len(of)) and float(of.mean()) > 0.5


if __name__ == "__main__":
    main()
