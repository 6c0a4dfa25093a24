"""`posenet predict`: poses for depth images, whoever took them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.camera import Camera
from evalkit.documents import PredictionImage, Predictions
from evalkit.errors import InputError
from evalkit.objects import ObjectModel
from posenet.dataset import intrinsics_of
from posenet.device import choose_device, supports_bf16
from posenet.model_file import load_model
from posenet.network import ImagePoses, PoseNetwork
from posenet.refine import Refiner

REFINED_HYPOTHESES = 200  # an image, the best by the network
RESCALE_TOLERANCE = 0.02  # focal lengths this close to the training camera's need no resampling


@dataclass(frozen=True, eq=False)
class PredictedPoses:
    """Poses found in one image, sorted by score."""

    cam_from_obj: NDArray[np.float64]  # (n, 4, 4) metres, the mesh's own frame
    score: NDArray[np.float64]  # (n,) in [0, 1]
    boxes: NDArray[np.float64]  # (n, 4) x0, y0, x1, y1 of the detection each comes from, pixels
    time_s: float


class Predictor:
    """A trained model, ready to use: ``Predictor.load("model.pt").predict(depth, camera)``."""

    def __init__(self, network: PoseNetwork, record: dict[str, Any] | None = None, refine: bool = False) -> None:
        self.network, self.record = network.eval(), record or {}
        self.refiner = Refiner(network.model) if refine else None
        self.device = next(network.parameters()).device
        network.bf16 = supports_bf16(self.device)

    @classmethod
    def load(cls, source: Path | str, device: str = "auto", refine: bool = False) -> Predictor:
        """From a model file or a run's folder; `refine` has every pose fitted to the image and verified against it.

        Raises:
            InputError: there is no usable model, or no such device.
        """
        trained = load_model(source, choose_device(device))
        return cls(trained.network, trained.record, refine)

    @property
    def model(self) -> ObjectModel:
        return self.network.model

    def predict(self, depth: NDArray[Any], camera: Camera) -> PredictedPoses:
        """Poses in one depth image (height, width), metres, 0 or NaN = no return.

        Raises:
            InputError: the image does not fit the camera, or its depths cannot be metres.
        """
        return self.predict_batch([depth], camera)[0]

    def predict_batch(self, depths: list[NDArray[Any]], camera: Camera) -> list[PredictedPoses]:
        """As :meth:`predict`, for several images of one camera at once."""
        started = time.perf_counter()
        clean = [self._checked(depth, camera) for depth in depths]
        scaled_camera = self._training_scale(camera)
        images = torch.stack([_resample(torch.from_numpy(depth), scaled_camera) for depth in clean]).to(self.device)
        intrinsics = intrinsics_of(scaled_camera).expand(len(images), 4).to(self.device)
        found = self.network.predict(images, intrinsics)
        scale = camera.width / scaled_camera.width
        in_mesh_frame = [self._in_mesh_frame(image, scale) for image in found]
        if self.refiner is not None:
            refiner = self.refiner
            in_mesh_frame = [_refined(refiner, *pair, camera) for pair in zip(clean, in_mesh_frame, strict=True)]
        seconds = (time.perf_counter() - started) / len(depths)
        return [replace(image, time_s=seconds) for image in in_mesh_frame]

    def _in_mesh_frame(self, image: ImagePoses, scale: float) -> PredictedPoses:
        cam_from_obj = self.network.codec.cam_from_obj(image.rotation, image.center)
        boxes = image.box.double().cpu().numpy() * scale
        return PredictedPoses(cam_from_obj, image.score.double().cpu().numpy(), boxes, 0.0)

    def _training_scale(self, camera: Camera) -> Camera:
        """The camera whose focal length is the training camera's: the network knows objects of that size only."""
        scale = self.network.camera.fx / camera.fx
        if abs(scale - 1.0) < RESCALE_TOLERANCE:
            return camera
        return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))

    def _checked(self, depth: NDArray[Any], camera: Camera) -> NDArray[np.float32]:
        if depth.shape != (camera.height, camera.width):
            raise InputError(
                f"the depth image is {' x '.join(map(str, depth.shape[::-1]))} pixels but the camera says "
                f"{camera.width} x {camera.height}; give the camera that took it."
            )
        clean = np.nan_to_num(np.asarray(depth, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        clean = np.maximum(clean, 0.0)
        seen = clean[clean > 0]
        near, far = self.network.depth_range
        if len(seen) and not 0.05 * near < float(np.median(seen)) < 20 * far:
            raise InputError(
                f"the depth image's median is {np.median(seen):g} m, but the model was trained on objects "
                f"{near:.3g} to {far:.3g} m away; check the unit of its values (--depth-unit 0.001 for millimetres)."
            )
        return clean


def _refined(refiner: Refiner, depth: NDArray[np.float32], found: PredictedPoses, camera: Camera) -> PredictedPoses:
    """The poses fitted to the image, without duplicates, scored by the network and the image together."""
    most = min(len(found.score), REFINED_HYPOTHESES)
    refined = refiner.refine(depth, camera, found.cam_from_obj[:most], found.score[:most])
    score = refined.evidence * (0.5 + 0.5 * found.score[:most])
    kept = np.flatnonzero(~refined.duplicate)
    kept = kept[np.argsort(-score[kept], kind="stable")]
    return PredictedPoses(refined.cam_from_obj[kept], score[kept], found.boxes[kept], found.time_s)


def _resample(depth: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Depth (H, W) on the pixel grid of `camera`; nearest, for the mean of two depths is the depth of nothing."""
    if depth.shape == (camera.height, camera.width):
        return depth
    size = (camera.height, camera.width)
    return torch.nn.functional.interpolate(depth[None, None], size=size, mode="nearest-exact")[0, 0]


def to_document(model: ObjectModel, images: Iterator[tuple[str, PredictedPoses]]) -> Predictions:
    """Named images' poses as a preds.json document."""
    reference = {"name": model.name, "diameter": model.diameter}
    return Predictions(
        reference, [PredictionImage(name, poses.cam_from_obj, poses.score, poses.time_s) for name, poses in images]
    )
