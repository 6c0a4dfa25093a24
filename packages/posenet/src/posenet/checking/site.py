"""What a model meets on somebody's images, measured by its own verified poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage
from evalkit.depth.noise import depth_noise
from evalkit.depth.sources import DepthSource
from evalkit.errors import InputError
from evalkit.evidence.verdict import Verdict, Verifier
from evalkit.evidence.verification import MIN_SCORE, VerifiedImage, verify_image
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.checking.floor import above_floor
from posenet.prediction.any_camera import distance
from posenet.prediction.area_of_interest import AreaOfInterest, Mask
from posenet.prediction.predictor import Predictor

RANGE = (2, 98)  # percentiles of what is measured


class LookedAt(NamedTuple):
    """One image, and what its refined poses are worth."""

    depth: NDArray[np.float32]  # (height, width) meters
    camera: Camera
    found: VerifiedImage
    distance: float  # meters, about how far the parts are
    heap: int  # pixels that stand on the floor, or of everything where no floor is seen
    explained: int  # of them, by verified poses


@dataclass(frozen=True, eq=False)
class Site:
    """What all images say together."""

    images: list[LookedAt]
    model: ObjectModel

    def count(self, verdict: Verdict) -> int:
        return sum(int(image.found.are(verdict).sum()) for image in self.images)

    @property
    def distance(self) -> tuple[float, float]:
        """Meters to the parts: of verified poses, or, without any, to what may be parts."""
        centers = [
            self.model.centers(image.found.cam_from_obj[image.found.are(Verdict.VERIFIED)])[:, 2]
            for image in self.images
        ]
        known = np.concatenate(centers) if centers else np.zeros(0)
        near, far = np.percentile(known if len(known) else [image.distance for image in self.images], RANGE)
        return float(near), float(far)

    @property
    def pixels(self) -> tuple[float, float]:
        """The object's diameter in pixels, at the farthest and at the nearest."""
        near, far = self.distance
        focal = float(np.median([image.camera.fx for image in self.images]))
        return focal * self.model.diameter / max(far, 1e-6), focal * self.model.diameter / max(near, 1e-6)

    @property
    def noise(self) -> float:
        """Standard deviation (meters) of depth on smooth surfaces."""
        return float(np.median([depth_noise(image.depth) for image in self.images]))

    @property
    def holes(self) -> float | None:
        """Share of verified parts' visible surface without a return; None where no part is verified."""
        shares = [
            part.missing / max(1.0 - part.hidden, 1e-6)
            for image in self.images
            for part in image.found.evidence
            if part.verdict is Verdict.VERIFIED
        ]
        return float(np.mean(shares)) if shares else None

    @property
    def explained(self) -> float:
        """Share of the heap's pixels that verified poses explain."""
        return sum(image.explained for image in self.images) / max(sum(image.heap for image in self.images), 1)

    @property
    def contradicted_share(self) -> float:
        """Of the poses that are decided."""
        contradicted = self.count(Verdict.CONTRADICTED)
        return contradicted / max(contradicted + self.count(Verdict.VERIFIED), 1)


def look_at(predictor: Predictor, source: DepthSource, numbers: list[int], area: AreaOfInterest) -> Iterator[LookedAt]:
    """Predict on some images of a source and hold the poses against them; `predictor` refines.

    Raises:
        InputError: an image cannot be used.
    """
    verifier = Verifier(predictor.model)
    for number in numbers:
        camera, name = source.cameras[number], source.names[number]
        depth, mask = source.depth(number), area.mask(camera)
        if not (depth > 0).any():
            raise InputError(
                f"image '{name}' of {source.path} holds no depth: every pixel is empty or saturated; leave it out."
            )
        poses = predictor.predict_batch([depth], camera, [name], mask)[0]
        found = verify_image(PredictionImage(name, poses.cam_from_obj, poses.score), depth, camera, verifier, MIN_SCORE)
        heap = _heap(depth, camera, predictor.model, mask)
        explained = _explained(found, depth.shape) & heap
        away = distance(depth, predictor.network)
        yield LookedAt(depth, camera, found, away, int(heap.sum()), int(explained.sum()))


def _heap(depth: NDArray[np.float32], camera: Camera, model: ObjectModel, mask: Mask | None) -> NDArray[np.bool_]:
    heap = above_floor(depth, camera, model.diameter)
    return heap if mask is None else heap & mask


def _explained(found: VerifiedImage, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels (height, width) whose depth is that of a verified pose."""
    explained = np.zeros(shape, bool)
    for part in found.evidence:
        if part.verdict is Verdict.VERIFIED:
            v, u = np.unravel_index(part.pixels, shape)
            for dv in range(part.stride):  # a traced pixel stands for those that were skipped
                for du in range(part.stride):
                    explained[np.minimum(v + dv, shape[0] - 1), np.minimum(u + du, shape[1] - 1)] = True
    return explained
