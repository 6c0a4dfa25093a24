"""A classical peer on the same test images: point pair features (Drost et al. 2010), bare and with our refinement.

    python benchmarks/ppf_baseline.py MODEL SHARDS [--images 3]

* PPF: OpenCV contrib's `ppf_match_3d`, with its own clustering, scored by votes;
* PPF+PP: its raw hypotheses, the best by votes, fitted, scored and verified by posenet/refine.py;
* posenet: the network MODEL, alone and refined by the same code.

opencv-contrib-python-headless and the opencv-python-headless of this project are two copies of one module, so voting
runs in an environment of its own, made on the first run at --venv. Voting takes 10 s an image and more.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.commands.group import EXIT_BAD_INPUT
from evalkit.datasets.documents import GroundTruth, PredictionImage, Predictions
from evalkit.datasets.ground_truth import image as labeled_image
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel, sample_surface_with_normals
from evalkit.scoring.evaluation import average_precision
from evalkit.scoring.rules import Settings
from posenet.prediction.predictor import Predictor
from posenet.refinement.refiner import Refiner, observed_normals

Array = NDArray[np.float64]
REQUIREMENTS = ("opencv-contrib-python-headless>=4.8", "numpy>=1.26")
VENV = Path.home() / ".cache" / "binpose" / "ppf-venv"
MODEL_POINTS = 5000  # before OpenCV samples them
MOST_HYPOTHESES = 1500  # an image, to be refined


@dataclass
class Method:
    """One row: poses of each image so far, and what they took."""

    name: str
    images: list[PredictionImage] = field(default_factory=list)
    wall: float = 0.0
    cpu: float = 0.0

    def add(self, name: str, cam_from_obj: Array, score: Array, wall: float, cpu: float) -> None:
        self.images.append(PredictionImage(name, cam_from_obj, score))
        self.wall += wall
        self.cpu += cpu

    def line(self, model: ObjectModel, truth: GroundTruth) -> str:
        document = Predictions({"name": model.name, "diameter": model.diameter}, self.images)
        ap = average_precision(document, truth).ap
        count = sum(len(image.score) for image in self.images) / len(self.images)
        each = len(self.images)
        return f"| {self.name} | {ap:.3f} | {count:.0f} | {self.wall / each:.2f} | {self.cpu / each:.2f} |"


def environment(folder: Path) -> Path:
    """The Python of the environment for voting, made if there is none."""
    python = folder / "bin" / "python"
    if (
        subprocess.run([python, "-c", "import cv2.ppf_match_3d"], capture_output=True).returncode
        if python.exists()
        else 1
    ):
        print(f"making {folder} with {REQUIREMENTS[0]}", file=sys.stderr)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "-q", *REQUIREMENTS], check=True)
    return python


def oriented_cloud(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Points and normals (n, 6) of a depth image (height, width), where it has both."""
    normals = observed_normals(depth, np.array([camera.fx, camera.fy, camera.cx, camera.cy]))
    usable = (depth > 0) & (np.linalg.norm(normals, axis=-1) > 0.5)
    cloud = np.concatenate([camera.point_map(depth)[usable], normals[usable]], -1)
    return np.ascontiguousarray(cloud, dtype=np.float32)


def refined(
    refiner: Refiner, depth: NDArray[np.float32], camera: Camera, found: Array, votes: Array
) -> tuple[Array, Array]:
    """The poses (n, 4, 4) with most votes (n,) after refinement and verification, and their scores."""
    best = np.argsort(-votes, kind="stable")[:MOST_HYPOTHESES]
    share = votes[best] / max(votes.max(initial=0.0), 1.0)
    fitted = refiner.refine(depth, camera, found[best], share)
    return fitted.cam_from_obj, fitted.score


def compare(model: Path, shards: Path, images: int, python: Path) -> Iterator[str]:
    """The rows of the table, as Markdown."""
    dataset = ShardDataset(shards)
    frames = np.unique(np.linspace(0, len(dataset) - 1, images).round().astype(int)).tolist()
    head, views = dataset.header, [dataset[frame] for frame in frames]
    predictors = [Predictor.load(model, refine=refine) for refine in (False, True)]
    vertices, faces = head.object.vertices, head.object.faces
    if vertices is None or faces is None:
        raise InputError(f"{shards}: its object has no mesh, which point pair features are made of.")
    images_of = [labeled_image(*dataset.locate(frame)) for frame in frames]
    truth = GroundTruth(head.object, images_of, source=str(shards), share="geometric")
    refiner = Refiner(head.object)
    for predictor in predictors:  # compiled and warm before any time is taken
        predictor.predict(views[0].depth, head.camera)
    bare, processed, alone, whole = (Method(name) for name in ("PPF", "PPF+PP", "posenet", "posenet refined"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cloud = np.concatenate(sample_surface_with_normals(vertices, faces, MODEL_POINTS), -1)
        np.save(folder / "model.npy", cloud.astype(np.float32))
        for view in views:
            np.save(folder / f"scene-{view.image_id}.npy", oriented_cloud(view.depth, head.camera))
        subprocess.run([python, Path(__file__).with_name("ppf_voting.py"), folder], check=True, stdout=sys.stderr)
        for view in views:
            with np.load(folder / f"votes-{view.image_id}.npz", allow_pickle=False) as votes:
                bare.add(view.image_id, votes["clustered_poses"], votes["clustered_votes"], *votes["clustered_seconds"])
                (poses, score), wall, cpu = _timed(
                    refined, refiner, view.depth, head.camera, votes["raw_poses"], votes["raw_votes"]
                )
                voting = votes["raw_seconds"]
            processed.add(view.image_id, poses, score, wall + voting[0], cpu + voting[1])
            for method, predictor in ((alone, predictors[0]), (whole, predictors[1])):
                found, wall, cpu = _timed(predictor.predict, view.depth, head.camera)
                method.add(view.image_id, found.cam_from_obj, found.score, wall, cpu)
    asked = sum(int((image.visibility >= 0.5).sum()) for image in truth.images)
    yield f"{len(views)} images of {shards}, {asked} instances to find: {Settings(visibility='geometric').asked}"
    yield "| method | AP | hypotheses an image | seconds an image | CPU seconds an image |"
    yield "|---|---|---|---|---|"
    for method in (bare, processed, alone, whole):
        yield method.line(head.object, truth)


def _timed(work: Callable[..., Any], *arguments: Any) -> tuple[Any, float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(*arguments)
    return result, time.perf_counter() - wall, time.process_time() - cpu


def main(words: list[str] | None = None) -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("model", type=Path)
    arguments.add_argument("shards", type=Path)
    arguments.add_argument("--images", type=int, default=3, help="evenly spread over the shards")
    arguments.add_argument("--venv", type=Path, default=VENV, help="where voting's environment is, or shall be")
    options = arguments.parse_args(words)
    if options.images < 1:
        raise InputError(f"--images {options.images}: must be 1 or more.")
    for line in compare(options.model, options.shards, options.images, environment(options.venv)):
        print(line, flush=True)


if __name__ == "__main__":
    try:
        main()
    except (InputError, OSError, subprocess.CalledProcessError) as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
