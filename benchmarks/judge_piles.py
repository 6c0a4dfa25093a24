"""Piles whose refined poses the judge learns from and is tested on: what benchmarks/judge.py looks at."""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from commands import run
from evalkit.datasets.documents import GroundTruth, GroundTruthImage
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.objects.model import ObjectModel
from posenet.prediction.predictor import Predictor
from posenet.refinement.depth_evidence import ALREADY_EXPLAINED
from posenet.refinement.fits import Finalists
from posenet.refinement.judge import FORMAT, Judge, Regression
from posenet.refinement.refiner import Fitting, Refiner
from simulated_hypotheses import Hypotheses, simulated

Array = NDArray[np.float64]
SENSORS = ("stereo", "kinect", "ideal")
PILES = {"bunny": 3, "gear": 3, "brick": 3, "candlestick": 2, "cup": 2, "connector": 2}  # under so many of SENSORS
SEEDS = dict(zip(PILES, (7001, 7004, 7007, 7201, 7203, 7205), strict=True))  # of an object's first pile
FOREIGN = (
    ("bunny", "cup"),
    ("gear", "bunny"),
    ("connector", "brick"),
    ("bunny", "gear"),
    ("cup", "gear"),
    ("gear", "cup"),
)  # looked for, what is there
NOBODY = Judge(FORMAT, Regression(0.0, {}), Regression(0.0, {}))


@dataclass(frozen=True, eq=False)
class Image:
    """One image's best fits, and which of them are right."""

    id: str
    fitting: Fitting
    finalists: Finalists
    near: NDArray[np.bool_]  # (m,) within the threshold of an instance
    instance: NDArray[np.int64]  # (m,) the nearest
    truth: Array
    visibility: Array

    def explained(self, logit: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The share that better ones explain, and which are kept."""
        share = self.fitting.explained(self.finalists.fits.cam_from_obj, logit)
        return share, share <= ALREADY_EXPLAINED

    def right(self, score: Array, kept: NDArray[np.bool_]) -> Array:
        """1 for the best-scored near pose of each instance."""
        found, right = set(), np.zeros(len(score))
        for row in np.argsort(-score, kind="stable"):
            if kept[row] and self.near[row] and self.instance[row] not in found:
                found.add(self.instance[row])
                right[row] = 1.0
        return right


@dataclass(frozen=True, eq=False)
class Pile:
    """The images of one object, sensor and source of hypotheses."""

    name: str
    object: str  # what is looked for
    sensor: str
    model: ObjectModel
    images: list[Image]

    @property
    def foreign(self) -> bool:
        return not any(len(image.truth) for image in self.images)

    @cached_property
    def truth(self) -> GroundTruth:
        images = [GroundTruthImage(image.id, None, image.truth, image.visibility) for image in self.images]
        return GroundTruth(self.model, images, share="geometric")


def collected(options: argparse.Namespace) -> Iterator[Pile]:
    objects = options.objects.split(",")
    networks = {path: Predictor.load(path, "cpu", refine=True) for path in options.network}
    for name, number, sensor in [(o, n, s) for o in objects for n, s in enumerate(SENSORS[: PILES[o]])]:
        folder = options.out / f"{name}-{sensor}"
        run("simgen", "build", "--object", name, "--sensor", sensor, "--preset", "demo", "--scenes", options.scenes,
            "--views", 2, "--seed", SEEDS[name] + number, "-o", folder)  # fmt: skip
        yield pile(folder, name, sensor, None)
        for path, predictor in networks.items():
            if predictor.model.name == name:
                yield pile(folder, name, sensor, predictor, f"{path.parent.name}/{path.stem}")
    for wanted, there in FOREIGN:
        if {wanted, there} <= set(objects):
            model = ShardDataset(options.out / f"{wanted}-stereo").header.object
            yield pile(options.out / f"{there}-stereo", wanted, f"foreign {there}", model)
            for path, predictor in networks.items():
                if predictor.model.name == wanted:
                    yield pile(options.out / f"{there}-stereo", wanted, f"foreign {there}", predictor, path.stem)


def pile(
    folder: Path, name: str, sensor: str, proposer: Predictor | ObjectModel | None, source: str = "simulated"
) -> Pile:
    """Refine hypotheses of `proposer` on the images in `folder`; without one, simulated ones of what is there."""
    dataset = ShardDataset(folder)
    foreign = sensor.startswith("foreign")
    model = dataset.header.object
    if foreign:
        assert proposer is not None
        model = proposer.model if isinstance(proposer, Predictor) else proposer
    refiner, images = Refiner(model, NOBODY), []
    for number in tqdm(range(len(dataset)), desc=f"{name} {sensor} {source}", disable=None):
        view = dataset[number]
        if isinstance(proposer, Predictor):
            found = proposed(proposer, view)
        else:
            rng = np.random.default_rng(zlib.crc32(f"{name} {sensor} {number}".encode()))
            instances = view.instances
            found = simulated(rng, model, instances.cam_from_obj, instances.visibility("geometric"), foreign)
        if len(found.score):
            images.append(refined(refiner, view, found, foreign))
    return Pile(f"{name} {sensor}, {source}", name, sensor, model, images)


def proposed(predictor: Predictor, view: View) -> Hypotheses:
    """What the network says, before refinement, with as many detections as refinement asks for."""
    refiner, predictor.refiner = predictor.refiner, None
    found = predictor.predict(view.depth, view.camera)
    predictor.refiner = refiner
    return Hypotheses(found.cam_from_obj, found.score, found.detection)


def refined(refiner: Refiner, view: View, found: Hypotheses, foreign: bool) -> Image:
    fitting = Fitting(refiner, view.depth, view.camera, found.cam_from_obj, found.score, found.detection)
    finalists = fitting.judged(*fitting.search())
    truth = view.instances.cam_from_obj[: 0 if foreign else None]
    poses = finalists.fits.cam_from_obj
    away = np.full((len(poses), len(truth) + 1), np.inf)
    for column, pose in enumerate(truth):
        away[:, column] = refiner.distance(poses, np.broadcast_to(pose, poses.shape))
    near, instance = away.min(1) < refiner.model.threshold, away.argmin(1)
    visibility = view.instances.visibility("geometric")[: len(truth)]
    return Image(view.image_id, fitting, finalists, near, instance, truth, visibility)
