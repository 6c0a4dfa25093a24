"""Where a network's losses come from: its AP with each stage replaced by the truth in turn.

    python benchmarks/error_budget.py MODEL SHARDS [--images 80] [--device cpu]

Sym AP, Siléane protocol, of posenet's predictions alone and refined (`--refine`), and the same where only instances of
one band of visibility are to be found. What replaces a stage, everything after it being the network's own:

* boxes: the visible boxes of all instances that training asks for, each with one and the same score;
* center, depth, rotation: what the region's heads would say if they were right, of the instance that the box overlaps
  most; regions of no instance keep what the network says. A coding that cannot say the truth (bins that are not
  interpolated, depths beyond them) keeps its error, and the row shows it;
* ranking: of the hypotheses that there are, those that are right come first.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from evalkit.commands.group import EXIT_BAD_INPUT
from evalkit.datasets.documents import GroundTruth, PredictionImage, Predictions
from evalkit.datasets.ground_truth import image as labeled_image
from evalkit.datasets.scene import Instances
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.objects.model import ObjectModel
from evalkit.scoring.agreement import require_same_subject
from evalkit.scoring.breakdown import by_visibility
from evalkit.scoring.distances import Sym
from evalkit.scoring.evaluation import Subject
from evalkit.scoring.rules import Settings
from posenet.coding.class_bins import Bins
from posenet.detectors.base import DetectionLimits, Detections, Detector
from posenet.layers.ops import box_iou
from posenet.network.pose_heads import PoseOutputs
from posenet.network.pose_network import PoseNetwork
from posenet.network.regions import Regions
from posenet.network.stages import ImageFeatures
from posenet.prediction.any_camera import trained_grid
from posenet.prediction.predictor import PredictedPoses, Predictor

POSE_STAGES = ("center", "depth", "rotation")
STAGES = ("boxes", *POSE_STAGES, "ranking")
ROWS: dict[str, tuple[str, ...]] = {
    "as predicted": (),
    **{f"true {stage}": (stage,) for stage in STAGES},
    "true center and depth": ("center", "depth"),
    "true pose": POSE_STAGES,
    "all of it true": STAGES,
}
BOX_SCORE = 0.95  # of a true box: surer than most that are found, but nothing that a network never sees
LEAST_OVERLAP = 0.3  # IoU; a box that overlaps no instance so much shows none
LOWEST_BAND = 0.2
RULES = Settings(visibility="geometric")
SURE = -20.0  # logit of what a head excludes


@dataclass(frozen=True, eq=False)
class TrueInstances:
    """One image's instances that have a pixel with a return, on the pixel grid that the network sees."""

    cam_from_obj: Tensor  # (n, 4, 4)
    boxes: Tensor  # (n, 4) around the pixels with a return
    visibility: Tensor  # (n,) returned share

    @classmethod
    def of(cls, labels: Instances, scale: tuple[float, float], device: torch.device) -> TrueInstances:
        seen = labels[labels.pixels_returned > 0]
        boxes = seen.box_returned * np.array([*scale, *scale])
        arrays = (seen.cam_from_obj, boxes, seen.visibility_returned)
        return cls(*(torch.tensor(np.asarray(array), dtype=torch.float32, device=device) for array in arrays))


class TrueDetector(Detector):
    """Detects what `instances` says, whatever the features."""

    def __init__(self, min_visibility: float) -> None:
        super().__init__()
        self.min_visibility = min_visibility
        self.instances: TrueInstances | None = None

    def forward(self, features: Tensor, image_size: tuple[int, int]) -> None:
        return None

    def losses(self, *_: Any) -> Any:
        raise NotImplementedError("it only predicts")

    def detect(self, raw: Any, limits: DetectionLimits | None = None) -> list[Detections]:
        assert self.instances is not None
        boxes = self.instances.boxes[self.instances.visibility >= self.min_visibility]
        return [Detections(boxes, torch.full((len(boxes),), BOX_SCORE, device=boxes.device))]


class PartlyTrueNetwork(PoseNetwork):
    """A trained network, some of whose heads know the truth of the one image at hand."""

    instances: TrueInstances
    replaced: tuple[str, ...] = ()

    def read(self, images: ImageFeatures, regions: Regions) -> PoseOutputs:
        outputs = super().read(images, regions)
        return self._corrected(outputs, regions) if len(self.instances.boxes) and len(regions.boxes) else outputs

    def _corrected(self, outputs: PoseOutputs, regions: Regions) -> PoseOutputs:
        """The outputs (n regions) with the replaced stages' parts as they should be, where a region has an instance."""
        overlap, instance = box_iou(regions.boxes, self.instances.boxes).max(1)
        known = overlap >= LEAST_OVERLAP
        labels = self.codec.encode(
            self.instances.cam_from_obj[instance], regions.windows, regions.reference_depth, regions.intrinsics
        )

        def corrected(truth: Tensor, said: Tensor) -> Tensor:
            return torch.where(known.view(-1, *[1] * (said.dim() - 1)), truth.to(said), said)

        if "center" in self.replaced:
            outputs = outputs._replace(offset=corrected(labels.offset, outputs.offset))
        if "depth" in self.replaced:
            logits = _certain(self.codec.depth_bins, labels.depth)
            outputs = outputs._replace(depth=corrected(logits, outputs.depth))
        if "rotation" in self.replaced:
            bins, said = self.codec.angle_bins, outputs.angles
            a, b, c = (corrected(_certain(bins[i], labels.angles[:, i]), said[i]) for i in range(3))
            outputs = outputs._replace(angles=(a, b, c), rotation=corrected(labels.rotation, outputs.rotation))
        return outputs


def _certain(bins: Bins, value: Tensor) -> Tensor:
    """Logits (n, count) of the two bins about each value (n,), whose mean is the value."""
    position = bins.position(value)
    position = position if bins.circular else position.clamp(0, bins.count - 1)
    low = position.floor()
    share = (position - low)[:, None]
    first = torch.nn.functional.one_hot(low.long() % bins.count, bins.count)
    second = torch.nn.functional.one_hot((low.long() + 1) % bins.count, bins.count)
    return (first * (1 - share) + second * share).log().clamp(min=SURE)


def ranked_by_truth(found: PredictedPoses, cam_from_obj: NDArray[np.float64], model: ObjectModel) -> PredictedPoses:
    """The hypotheses that are right, one for each of the instances (n, 4, 4), a whole point above all others."""
    score = found.score.copy()
    if len(score) and len(cam_from_obj):
        h, n = len(score), len(cam_from_obj)
        pairs = np.repeat(found.cam_from_obj, n, 0), np.tile(cam_from_obj, (h, 1, 1))
        distance = Sym(model)(*pairs).reshape(h, n)
        nearest = distance.argmin(0)
        right = (distance.min(0) <= model.threshold) & (distance[nearest].argmin(1) == np.arange(n))
        score[nearest[right]] += 1.0
    return replace(found, score=score)


@dataclass(frozen=True, eq=False)
class Budget:
    """AP of one row, alone and refined, and by bands of visibility from LOWEST_BAND up."""

    name: str
    ap: tuple[float, float]
    bands: tuple[list[float], list[float]]


class Study:
    """One model on some frames of shards.

    Raises:
        InputError: the model or the shards cannot be used, or they are of different objects.
    """

    def __init__(self, model: Path, shards: Path, images: int, device: str = "auto") -> None:
        self.dataset = ShardDataset(shards)
        self.frames = np.unique(np.linspace(0, len(self.dataset) - 1, images).round().astype(int)).tolist()
        self.predictors = [Predictor.load(model, device, refine) for refine in (False, True)]
        self.networks = [predictor.fast for predictor in self.predictors]
        self.detectors = [network.detector for network in self.networks]
        for network in self.networks:
            network.__class__ = PartlyTrueNetwork
        images_of = [labeled_image(*self.dataset.locate(frame)) for frame in self.frames]
        self.truth = GroundTruth(self.dataset.header.object, images_of, source=str(shards), share="geometric")
        require_same_subject(self._document([]), self.truth)

    def row(self, name: str) -> Budget:
        """One of ROWS."""
        stages = ROWS[name]
        found: tuple[list[PredictionImage], list[PredictionImage]] = ([], [])
        for number, frame in enumerate(tqdm(self.frames, desc=name, unit=" images", disable=None)):
            truth = self.truth.images[number]
            for which in (0, 1):
                poses = self._predict(which, frame, stages)
                if "ranking" in stages:
                    poses = ranked_by_truth(poses, truth.cam_from_obj, self.truth.object)
                found[which].append(PredictionImage(truth.id, poses.cam_from_obj, poses.score))
        alone, refined = (self._scored(images) for images in found)
        return Budget(name, (alone[0], refined[0]), (alone[1], refined[1]))

    def _predict(self, which: int, frame: int, stages: tuple[str, ...]) -> PredictedPoses:
        predictor, network = self.predictors[which], self.networks[which]
        reader, row = self.dataset.locate(frame)
        camera, depth = reader.header.camera, reader.depth_raw(row) * np.float32(reader.header.depth_unit)
        grid = trained_grid(predictor.clean(depth, camera), camera, network)
        scale = (grid.width / camera.width, grid.height / camera.height)
        assert isinstance(network, PartlyTrueNetwork)
        network.replaced = stages
        network.instances = TrueInstances.of(reader.labels(row), scale, predictor.device)
        network.detector = self.detectors[which]
        if "boxes" in stages:
            network.detector = TrueDetector(network.config.train.min_visibility)
            network.detector.instances = network.instances
        return predictor.predict(depth, camera)

    def _scored(self, images: list[PredictionImage]) -> tuple[float, list[float]]:
        subject = Subject.of(self._document(images), self.truth, RULES)
        bands = [band.ap for band in by_visibility(subject, RULES) if band.low >= LOWEST_BAND - 1e-9]
        return subject.score(RULES, subject.pairs(RULES)).ap, bands

    def _document(self, images: list[PredictionImage]) -> Predictions:
        model = self.predictors[0].model
        return Predictions({"name": model.name, "diameter": model.diameter}, images)


def table(budgets: Iterable[Budget]) -> Iterator[str]:
    """The rows as Markdown: first the stages, as they come, then the bands of visibility."""
    yield "| stage | AP alone | gain | AP refined | gain |"
    yield "|---|---|---|---|---|"
    known: list[Budget] = []
    for budget in budgets:
        known.append(budget)
        gains = [
            f"{now - then:+.3f}" if len(known) > 1 else "" for now, then in zip(budget.ap, known[0].ap, strict=True)
        ]
        yield f"| {budget.name} | {budget.ap[0]:.3f} | {gains[0]} | {budget.ap[1]:.3f} | {gains[1]} |"
    lows = [LOWEST_BAND + 0.1 * i for i in range(len(known[0].bands[0]))]
    titles = [f"{100 * low:.0f}–{100 * low + 10:.0f} %" for low in lows]
    for which, kind in enumerate(("alone", "refined")):
        yield ""
        yield f"| AP {kind}, by visibility | " + " | ".join(titles) + " |"
        yield "|---" * (len(titles) + 1) + "|"
        for budget in known:
            cells = ["" if np.isnan(ap) else f"{ap:.3f}" for ap in budget.bands[which]]
            yield f"| {budget.name} | " + " | ".join(cells) + " |"


def main(words: list[str] | None = None) -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("model", type=Path)
    arguments.add_argument("shards", type=Path)
    arguments.add_argument("--images", type=int, default=80, help="evenly spread over the shards")
    arguments.add_argument("--device", default="auto")
    options = arguments.parse_args(words)
    if options.images < 1:
        raise InputError(f"--images {options.images}: must be 1 or more.")
    study = Study(options.model, options.shards, options.images, options.device)
    instances = sum(int((image.visibility >= 0.5).sum()) for image in study.truth.images)
    print(f"{options.model} on {len(study.frames)} images of {options.shards}, {instances} to find: {RULES.asked}")
    for line in table(study.row(name) for name in ROWS):
        print(line, flush=True)


if __name__ == "__main__":
    try:
        main()
    except (InputError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
