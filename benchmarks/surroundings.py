"""What stands around a bin must not matter: AP where everything beyond it is replaced by a wall.

    python benchmarks/surroundings.py MODEL SHARDS [--walls -0.3 0.15] [--images 40] [--refine]

SHARDS of `simgen build` whose bin has one size. A wall stands across the image, so many meters behind (or, below 0, in
front of) the median depth of the instances, wherever a pixel shows nothing of the bin. AP is Sym, Siléane protocol,
instances at least half visible (geometric). Beside it: by how much the wall moves the depth about which the network
sees the image (median over the images).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from as_typed import table
from evalkit.commands.group import EXIT_BAD_INPUT
from evalkit.datasets.documents import GroundTruth, PredictionImage, Predictions
from evalkit.datasets.ground_truth import image as labeled_image
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.scoring.agreement import require_same_subject
from evalkit.scoring.evaluation import Subject
from evalkit.scoring.rules import Settings
from posenet.prediction.any_camera import distance
from posenet.prediction.predictor import Predictor

RULES = Settings(visibility="geometric")
WALLS = (-0.3, -0.15, 0.15, 0.3)
RIM = 1.08  # of the bin's inner size: its walls belong to it


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("shards", type=Path)
    parser.add_argument("--walls", type=float, nargs="*", default=WALLS, help="meters behind the instances")
    parser.add_argument("--images", type=int, default=40, help="evenly spread over the shards")
    parser.add_argument("--refine", action="store_true")
    options = parser.parse_args(words)
    walls = [None, *options.walls]
    study = Study(options.model, options.shards, options.images, options.refine)
    rows = [[_title(wall), *(f"{value:.3f}" for value in study.row(wall))] for wall in walls]
    print(f"{options.model} on {len(study.frames)} images of {options.shards}: {RULES.asked}")
    print(table(["beyond the bin", "AP", "depth moved by, m"], rows))


class Study:
    """One model on some frames of shards.

    Raises:
        InputError: the model or the shards cannot be used, or they are of different objects.
    """

    def __init__(self, model: Path, shards: Path, images: int, refine: bool = False) -> None:
        self.dataset = ShardDataset(shards)
        self.frames = np.unique(np.linspace(0, len(self.dataset) - 1, images).round().astype(int)).tolist()
        self.predictor = Predictor.load(model, refine=refine)
        labeled = [labeled_image(*self.dataset.locate(frame)) for frame in self.frames]
        self.truth = GroundTruth(self.dataset.header.object, labeled, source=str(shards), share="geometric")
        require_same_subject(self._document([]), self.truth)
        inner = self.dataset.header.config.get("bin")
        if not isinstance(inner, dict):
            raise InputError(f"{shards}: the shards have no bin beyond which a wall could stand.")
        self.bin_sides = np.array([inner["width"], inner["depth"]])  # meters

    def row(self, wall: float | None) -> tuple[float, float]:
        """AP, and the median of how far the wall moves the images' depth; None leaves the images as they are."""
        found, moved = [], []
        for frame, truth in zip(self.frames, self.truth.images, strict=True):
            view = self.dataset[frame]
            depth = view.depth if wall is None else self.behind_a_wall(view, wall)
            moved.append(distance(depth, self.predictor.network) - distance(view.depth, self.predictor.network))
            poses_found = self.predictor.predict(depth, view.camera)
            found.append(PredictionImage(truth.id, poses_found.cam_from_obj, poses_found.score))
        subject = Subject.of(self._document(found), self.truth, RULES)
        return subject.score(RULES, subject.pairs(RULES)).ap, float(np.median(moved))

    def behind_a_wall(self, view: View, wall: float) -> NDArray[np.float32]:
        """The view's depth (height, width) with a wall wherever it shows nothing of the bin."""
        seen = view.camera.point_map(view.depth)
        world = poses.apply(poses.invert(view.cam_from_world), seen.reshape(-1, 3)).reshape(seen.shape)
        beyond = (np.abs(world[..., :2]) > RIM / 2 * self.bin_sides).any(-1) & (view.depth > 0)
        centers = self.dataset.header.object.centers(view.instances.cam_from_obj)
        return np.where(beyond, np.float32(np.median(centers[:, 2]) + wall), view.depth)

    def _document(self, images: list[PredictionImage]) -> Predictions:
        model = self.predictor.model
        return Predictions({"name": model.name, "diameter": model.diameter}, images)


def _title(wall: float | None) -> str:
    return "as rendered" if wall is None else f"a wall {abs(wall):g} m {'nearer' if wall < 0 else 'farther'}"


if __name__ == "__main__":
    try:
        main()
    except (InputError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
