"""`posenet predict`: poses for depth images, whoever took them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage, Predictions
from evalkit.depth.clean import clean_depth
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.device import choose_device, layers_in_bf16
from posenet.models.model_file import load_model
from posenet.network.depth_input import intrinsics_of, resample
from posenet.network.pose_network import PoseNetwork
from posenet.network.predict_options import PredictOptions
from posenet.network.stages import ImagePoses
from posenet.prediction.any_camera import check_distance, trained_grid
from posenet.prediction.area_of_interest import Mask, cut_out
from posenet.prediction.fast_network import fast_network
from posenet.refinement.refiner import Fitting, Refiner, refine_together

# Refinement tells two boxes of one instance from two instances, so it may have both, and more of them.
REFINED_DETECTIONS, REFINED_OVERLAP = 128, 0.75
PIXELS_AT_ONCE = 1 << 21  # of the images that go through the network together


@dataclass(frozen=True, eq=False)
class PredictedPoses:
    """The n poses found in one image, sorted by score, best first."""

    cam_from_obj: NDArray[np.float64]  # (n, 4, 4) meters, the mesh's own frame to the camera's (x right, z forward)
    score: NDArray[np.float64]  # (n,) in [0, 1]
    boxes: NDArray[np.float64]  # (n, 4) x0, y0, x1, y1 of the detection each comes from, pixels
    detection: NDArray[np.int64]  # (n,) number of that detection: hypotheses of one detection have the same
    time_s: float  # seconds spent on the image


class Predictor:
    """A trained model, ready to use: ``Predictor.load("model.pt").predict(depth, camera)``.

    The network stays as it is: several predictors may share it. A network that has learned more since needs another
    predictor.
    """

    def __init__(
        self,
        network: PoseNetwork,
        record: dict[str, Any] | None = None,
        refine: bool = False,
        options: PredictOptions | None = None,
        precision: str = "auto",
    ) -> None:
        self.network, self.record = network, record or {}
        self.refiner = Refiner(network.model) if refine else None
        self.options = options or PredictOptions()
        if refine and self.options.detection is None:
            own = network.detector.limits
            limits = replace(own, nms_iou=REFINED_OVERLAP, least=max(REFINED_DETECTIONS, own.least))
            self.options = replace(self.options, detection=limits)
        self.device = next(network.parameters()).device
        self.fast = fast_network(network, layers_in_bf16(precision, self.device))

    @classmethod
    def load(
        cls,
        source: Path | str,
        device: str = "auto",
        refine: bool = False,
        options: PredictOptions | None = None,
        precision: str = "auto",
    ) -> Predictor:
        """From a model file or a run's folder; `refine` has every pose fitted to the image and verified against it.

        `precision` is that of the network's layers, one of :data:`posenet.device.PRECISIONS`.

        Raises:
            InputError: there is no usable model, no such device or no such precision.
        """
        trained = load_model(source, choose_device(device))
        return cls(trained.network, trained.record, refine, options, precision)

    @property
    def precision(self) -> str:
        """What the layers run in: float32 or bfloat16."""
        return "bfloat16" if self.fast.bf16 else "float32"

    @property
    def model(self) -> ObjectModel:
        return self.network.model

    def predict(self, depth: NDArray[Any], camera: Camera, mask: Mask | None = None) -> PredictedPoses:
        """Poses in one depth image (height, width) of any number type: axial z in meters, 0 or NaN = no return.

        Any resolution and any pinhole camera will do: the image is resampled so that the object has its trained size.
        Of a `mask` (height, width) only what is True is looked at: the bin, without what stands around it.

        Raises:
            InputError: the image does not fit the camera, its depths cannot be meters, or the mask fits no image.
        """
        return self.predict_batch([depth], camera, mask=mask)[0]

    def predict_batch(
        self, depths: Sequence[NDArray[Any]], camera: Camera, names: Sequence[str] = (), mask: Mask | None = None
    ) -> list[PredictedPoses]:
        """As :meth:`predict`, for several images of one camera at once; `names` call them in messages."""
        return predict_together([self], depths, camera, names, mask)[0]

    def clean(self, depth: NDArray[Any], camera: Camera, title: str = "the depth image") -> NDArray[np.float32]:
        """The image with 0 wherever nothing returned.

        Raises:
            InputError: see :meth:`predict`.
        """
        clean = clean_depth(depth, camera, title)
        check_distance(clean, camera, self.network, title)
        return clean

    def proposed(self, depths: list[NDArray[np.float32]], camera: Camera) -> list[PredictedPoses]:
        """What the network alone says of clean images.

        Each is on the pixel grid that suits it; those of one grid go together, as many as memory allows.
        """
        found: list[PredictedPoses] = [_NOTHING] * len(depths)
        grids = [trained_grid(depth, camera, self.network) for depth in depths]
        for grid in dict.fromkeys(grids):
            rows = [row for row, other in enumerate(grids) if other == grid]
            together = max(1, PIXELS_AT_ONCE // (grid.width * grid.height))
            for start in range(0, len(rows), together):
                some = rows[start : start + together]
                for row, poses in zip(some, self._on_grid([depths[row] for row in some], camera, grid), strict=True):
                    found[row] = poses
        return found

    def _on_grid(self, depths: list[NDArray[np.float32]], camera: Camera, grid: Camera) -> list[PredictedPoses]:
        images = torch.stack([resample(torch.from_numpy(depth), grid) for depth in depths]).to(self.device)
        intrinsics = intrinsics_of(grid).expand(len(images), 4).to(self.device)
        with torch.inference_mode():
            found = self.fast.predict(images, intrinsics, self.options)
        return [self._in_mesh_frame(image, camera, grid) for image in found]

    def _in_mesh_frame(self, image: ImagePoses, camera: Camera, grid: Camera) -> PredictedPoses:
        cam_from_obj = self.network.codec.cam_from_obj(image.rotation, image.center)
        scale = np.tile([camera.width / grid.width, camera.height / grid.height], 2)
        boxes = np.minimum(image.box.double().cpu().numpy() * scale, [camera.width, camera.height] * 2)
        score, detection = image.score.double().cpu().numpy(), image.detection.cpu().numpy()
        return PredictedPoses(cam_from_obj, score, boxes, detection, 0.0)


_NOTHING = PredictedPoses(np.zeros((0, 4, 4)), np.zeros(0), np.zeros((0, 4)), np.zeros(0, np.int64), 0.0)


def predict_together(
    predictors: Sequence[Predictor],
    depths: Sequence[NDArray[Any]],
    camera: Camera,
    names: Sequence[str] = (),
    mask: Mask | None = None,
) -> list[list[PredictedPoses]]:
    """As :meth:`Predictor.predict_batch`, of several parts in the same images: for each predictor, poses of each image.

    Poses of all parts compete for what the image shows, if every predictor refines: a surface that one part explains
    better speaks for no other, and no two parts are inside each other.

    Raises:
        InputError: see :meth:`Predictor.predict`; or some of several predictors do not refine.
    """
    refiners = [predictor.refiner for predictor in predictors if predictor.refiner is not None]
    if len(predictors) > 1 and len(refiners) < len(predictors):
        raise InputError("poses of several parts compete by what the image shows of them; load every model to refine.")
    started = time.perf_counter()
    titles = [f"image '{name}'" for name in names] or ["the depth image"] * len(depths)
    clean = [clean_depth(depth, camera, title) for depth, title in zip(depths, titles, strict=True)]
    corner = (0, 0)
    if mask is not None:
        clean, camera, corner = cut_out(clean, camera, mask)
    for predictor in predictors:
        for depth, title in zip(clean, titles, strict=True):
            check_distance(depth, camera, predictor.network, title)
    found = [predictor.proposed(clean, camera) for predictor in predictors]
    if refiners and clean:
        images = zip(clean, zip(*found, strict=True), strict=True)
        found = [list(part) for part in zip(*(_refined(refiners, *image, camera) for image in images), strict=True)]
    seconds = (time.perf_counter() - started) / max(len(depths), 1)
    shift = np.tile(corner, 2)
    return [[replace(image, boxes=image.boxes + shift, time_s=seconds) for image in part] for part in found]


def _refined(
    refiners: Sequence[Refiner], depth: NDArray[np.float32], found: Sequence[PredictedPoses], camera: Camera
) -> list[PredictedPoses]:
    """Poses of each part fitted to the image: one a detection, without duplicates, scored by what the image says."""
    fittings = [
        Fitting(refiner, depth, camera, part.cam_from_obj, part.score, part.detection)
        for refiner, part in zip(refiners, found, strict=True)
    ]
    return [
        PredictedPoses(refined.cam_from_obj, refined.score, part.boxes[row], part.detection[row], part.time_s)
        for refined, part in zip(refine_together(fittings), found, strict=True)
        for row in [refined.hypothesis]
    ]


def to_document(model: ObjectModel, images: Iterator[tuple[str, PredictedPoses]]) -> Predictions:
    """Named images' poses as a preds.json document."""
    found = [PredictionImage(name, poses.cam_from_obj, poses.score, poses.time_s) for name, poses in images]
    return Predictions(model.reference, found)
