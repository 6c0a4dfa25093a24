"""The poses of a preds.json held against their depth images: how many are verified, how many contradicted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage, Predictions
from evalkit.depth.sources import DepthSource
from evalkit.errors import InputError
from evalkit.evidence.verdict import PoseEvidence, Verdict, Verifier
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

FORMAT = "binpose-verification/1"
SAME_PART = 0.5  # of a pose's agreeing pixels that speak for a better one: both mean the same instance
MIN_SCORE = 0.5
OTHER_SIZE = 0.05  # by which the diameter that predictions state may differ from the mesh's


@dataclass(frozen=True, eq=False)
class VerifiedImage:
    """The poses of one image, best score first."""

    id: str
    cam_from_obj: NDArray[np.float64]  # (n, 4, 4)
    score: NDArray[np.float64]  # (n,)
    row: NDArray[np.int64]  # (n,) number of each in the document
    evidence: list[PoseEvidence]
    duplicate_of: list[int | None]  # of a verified pose: the better one, by its place here, that means the same part

    def are(self, verdict: Verdict) -> NDArray[np.bool_]:
        """Which poses (n,) have a verdict; duplicates are not among the verified."""
        duplicate = np.array([other is not None for other in self.duplicate_of], bool)
        found = np.array([part.verdict is verdict for part in self.evidence], bool)
        return found & ~duplicate if verdict is Verdict.VERIFIED else found


@dataclass(frozen=True, eq=False)
class Verification:
    """What images say of predictions, those scored at least `min_score`."""

    images: list[VerifiedImage]
    min_score: float
    model: ObjectModel

    def count(self, verdict: Verdict) -> int:
        return sum(int(image.are(verdict).sum()) for image in self.images)

    @property
    def duplicates(self) -> int:
        return sum(other is not None for image in self.images for other in image.duplicate_of)

    @property
    def precision(self) -> float:
        """Verified instances over all poses that are decided, duplicates among them; 1 where none is."""
        verified, contradicted = self.count(Verdict.VERIFIED), self.count(Verdict.CONTRADICTED)
        decided = verified + contradicted + self.duplicates
        return verified / decided if decided else 1.0

    def to_json(self) -> dict[str, Any]:
        """``binpose-verification/1``: totals, and every pose with its verdict, reason and shares."""
        return {
            "format": FORMAT,
            "object": {"name": self.model.name or None, "diameter": self.model.diameter},
            "min_score": self.min_score,
            "images": len(self.images),
            "poses": sum(len(image.score) for image in self.images),
            "verified": self.count(Verdict.VERIFIED),
            "contradicted": self.count(Verdict.CONTRADICTED),
            "undecided": self.count(Verdict.UNDECIDED),
            "duplicates": self.duplicates,
            "precision": self.precision,
            "poses_by_image": {image.id: _rows(image) for image in self.images},
        }


def verify(
    predictions: Predictions,
    source: DepthSource,
    model: ObjectModel,
    min_score: float = MIN_SCORE,
    tolerance: float | None = None,
) -> Verification:
    """Hold all poses scored at least `min_score` against the depth images of `source`, which their ids name.

    Args:
        tolerance: meters within which depth agrees; None: see :class:`evalkit.evidence.verdict.Verifier`.

    Raises:
        InputError: predictions are not in the camera's frame, are of another object, or no image has their ids.
    """
    _require_same_object(predictions, model)
    verifier = Verifier(model, tolerance)
    images = [
        verify_image(image, source.depth(number), source.cameras[number], verifier, min_score)
        for image, number in _paired(predictions, source)
    ]
    return Verification(images, min_score, model)


def verify_image(
    image: PredictionImage, depth: NDArray[np.float32], camera: Camera, verifier: Verifier, min_score: float = MIN_SCORE
) -> VerifiedImage:
    """The poses of one image scored at least `min_score`, held against its depth (height, width) in meters."""
    order = np.argsort(-image.score, kind="stable")
    order = order[image.score[order] >= min_score]
    evidence = verifier.examine(depth, camera, image.cam_from_obj[order])
    duplicates = _duplicates(evidence, depth.size)
    return VerifiedImage(image.id, image.cam_from_obj[order], image.score[order], order, evidence, duplicates)


def _duplicates(evidence: list[PoseEvidence], pixels: int) -> list[int | None]:
    """For each verified pose, best first, the better one of the same part; None where there is none."""
    owner = np.full(pixels, -1, np.int64)
    found: list[int | None] = []
    for number, part in enumerate(evidence):
        better = None
        if part.verdict is Verdict.VERIFIED:
            owners = owner[part.pixels]
            names, counts = np.unique(owners[owners >= 0], return_counts=True)
            if counts.sum() > SAME_PART * len(part.pixels):
                better = int(names[counts.argmax()])
            else:
                owner[part.pixels] = number
        found.append(better)
    return found


def _paired(predictions: Predictions, source: DepthSource) -> Iterator[tuple[PredictionImage, int]]:
    numbers = {name: number for number, name in enumerate(source.names)}
    missing = [image.id for image in predictions.images if image.id not in numbers]
    if missing or not predictions.images:
        known = ", ".join(source.names[:3]) + (" …" if len(source.names) > 3 else "")
        named = f"image '{missing[0]}' is not among" if missing else "names none of"
        raise InputError(
            f"{predictions.source}: {named} the images of {source.path} ({known}); give the images that were predicted "
            "on, whose names are the files' without the suffix."
        )
    for image in predictions.images:
        yield image, numbers[image.id]


def _require_same_object(predictions: Predictions, model: ObjectModel) -> None:
    if predictions.frame != "camera":
        raise InputError(
            f"{predictions.source}: its poses are in the world's frame, and images are in the camera's; convert them "
            "with 'evalkit preds' and --camera-params."
        )
    stated = predictions.object.get("diameter") if isinstance(predictions.object, dict) else None
    if stated is not None and abs(float(stated) / model.diameter - 1.0) > OTHER_SIZE:
        raise InputError(
            f"{predictions.source}: its object is {1e3 * float(stated):.4g} mm across, but the mesh is "
            f"{1e3 * model.diameter:.4g} mm; give the mesh that was trained on, and its --units."
        )


def _rows(image: VerifiedImage) -> list[dict[str, Any]]:
    return [
        {
            "hypothesis": int(row),
            "score": float(score),
            "verdict": part.verdict.value,
            "reason": part.reason,
            "duplicate_of": None if other is None else int(image.row[other]),
            "agreeing": round(part.agreeing, 4),
            "looked_through": round(part.through, 4),
            "hidden": round(part.hidden, 4),
            "missing": round(part.missing, 4),
            "moved_m": round(part.moved, 6),
        }
        for row, score, part, other in zip(image.row, image.score, image.evidence, image.duplicate_of, strict=True)
    ]
