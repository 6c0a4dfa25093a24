"""The peers by name, on frames of a dataset: inputs, the search in OpenCV's environment, poses and seconds."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage, Predictions
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from peers import contrib, linemod, ppf
from peers.clustering import clustered
from peers.post_processing import PostProcessing
from peers.smooth_surface import smooth_surface

Array = NDArray[np.float64]
METHODS = ("Linemod", "Linemod+PP", "PPF", "PPF+PP")


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Raw hypotheses on one image."""

    cam_from_obj: Array  # (n, 4, 4)
    strength: Array  # (n,) votes, or how well a template matches
    seconds: float  # from the depth image to here

    def of(self, rows: NDArray[np.bool_]) -> Hypotheses:
        return Hypotheses(self.cam_from_obj[rows], self.strength[rows], self.seconds)


def in_bin(cam_from_obj: Array, view: View, model: ObjectModel, config: dict[str, Any]) -> NDArray[np.bool_]:
    """Which poses (n, 4, 4) have their center in the bin; all of them where the dataset's scenes have no walls.

    Whoever runs such a method on a bin tells it where the bin stands, or walls and the floor around them win the votes.
    """
    bin_size = config.get("bin", {})
    if not bin_size.get("walls"):
        return np.ones(len(cam_from_obj), bool)
    center = poses.apply(poses.invert(view.cam_from_world), model.centers(cam_from_obj))
    largest = 1 + config.get("pile", {}).get("bin_jitter", 0.0)  # a scene's bin may be larger by this share
    half = largest * np.array([bin_size["width"], bin_size["depth"]]) / 2
    return (np.abs(center[:, :2]) <= half).all(1) & (center[:, 2] >= 0)


class Peer:
    """Finds one object on frames of `dataset`; what it finds is kept in the folder `work`.

    Raises:
        InputError: the object has no mesh.
    """

    script: str

    def __init__(self, dataset: ShardDataset, frames: Sequence[int], work: Path) -> None:
        self.model, self.camera, self.config = dataset.header.object, dataset.header.camera, dataset.header.config
        if self.model.vertices is None or self.model.faces is None:
            raise InputError(f"{dataset.paths[0]}: its object has no mesh, which the peers are made of.")
        self.views = [dataset[frame] for frame in frames]
        self.work = work

    def search(self) -> list[Hypotheses]:
        """The raw hypotheses on each frame, computed where they are not kept."""
        self.work.mkdir(parents=True, exist_ok=True)
        missing = [view for view in self.views if not self.found(view).exists()]
        if missing:
            self.write_inputs(missing)
            contrib.run(self.script, self.work)
            for file in self.work.glob("*.npy"):
                file.unlink()
        return [self.read(view) for view in self.views]

    def found(self, view: View) -> Path:
        return self.work / f"found-{view.image_id}.npz"

    def write_inputs(self, views: list[View]) -> None:
        raise NotImplementedError

    def read(self, view: View) -> Hypotheses:
        raise NotImplementedError

    def detect(self, found: Hypotheses) -> tuple[Array, Array]:
        """Poses (m, 4, 4) and scores (m,) as the method has them by itself."""
        raise NotImplementedError

    def predictions(self, post_processing: bool) -> Predictions:
        """The method's poses on all frames, with or without post-processing."""
        process = PostProcessing(self.model).process
        images = []
        for view, found in zip(self.views, self.search(), strict=True):
            found = found.of(in_bin(found.cam_from_obj, view, self.model, self.config))
            started = time.perf_counter()
            if post_processing:
                kept, score = process(view.depth, self.camera, found.cam_from_obj, found.strength)
            else:
                kept, score = self.detect(found)
            seconds = found.seconds + time.perf_counter() - started
            images.append(PredictionImage(view.image_id, kept, score, seconds))
        return Predictions({"name": self.model.name, "diameter": self.model.diameter}, images)


class PointPairs(Peer):
    script = ppf.SCRIPT

    def write_inputs(self, views: list[View]) -> None:
        np.save(self.work / "model.npy", ppf.model_cloud(self.model))
        for view in views:
            np.save(self.work / f"scene-{view.image_id}.npy", ppf.scene_cloud(view.depth, self.camera, self.model))

    def read(self, view: View) -> Hypotheses:
        with np.load(self.found(view), allow_pickle=False) as found:
            cam_from_obj, votes, seconds = found["poses"], found["strength"], float(found["seconds"][0])
        cam_from_obj[:, :3, 3] /= ppf.MILLIMETERS
        return Hypotheses(cam_from_obj, votes, seconds)

    def detect(self, found: Hypotheses) -> tuple[Array, Array]:
        return clustered(found.cam_from_obj, found.strength, self.model)


class Linemod(Peer):
    script = linemod.SCRIPT

    def search(self) -> list[Hypotheses]:
        started = time.perf_counter()
        surfaces = [smooth_surface(view.depth, self.camera, self.model.diameter)[0] for view in self.views]
        self.seconds = (time.perf_counter() - started) / len(self.views)
        seen = np.concatenate([surface[surface > 0] for surface in surfaces])
        if len(seen) == 0:
            raise InputError("no image has depth, so there is nothing to search.")
        nearest, farthest = (float(z) for z in np.percentile(seen, [1, 99]))
        self.coarse, every = linemod.coarser(self.camera, self.model.diameter, nearest)
        surfaces = [np.ascontiguousarray(surface[every // 2 :: every, every // 2 :: every]) for surface in surfaces]
        self.surface = dict(zip((view.image_id for view in self.views), surfaces, strict=True))
        self.templates = linemod.Templates.rendered(self.model, self.coarse, nearest, farthest)
        return super().search()

    def write_inputs(self, views: list[View]) -> None:
        whole = self.templates.whole_numbers
        np.save(self.work / "templates.npy", whole(self.templates.depth))
        np.save(self.work / "step.npy", np.int64(linemod.SURFACE_STEP * self.model.diameter / self.templates.unit))
        for view in views:
            np.save(self.work / f"scene-{view.image_id}.npy", whole(self.surface[view.image_id]))

    def read(self, view: View) -> Hypotheses:
        with np.load(self.found(view), allow_pickle=False) as found:
            template, corner, similarity = found["template"], found["corner"], found["strength"]
            seconds = float(found["seconds"][0])
        started = time.perf_counter()
        found_poses, agreement = self.templates.poses(self.surface[view.image_id], self.coarse, template, corner)
        strength = similarity / 100 * agreement
        inside = np.flatnonzero(in_bin(found_poses, view, self.model, self.config))
        kept = inside[linemod.spread_out(found_poses[inside], strength[inside], self.model)]
        seconds += self.seconds + time.perf_counter() - started
        return Hypotheses(found_poses[kept], strength[kept], seconds)

    def detect(self, found: Hypotheses) -> tuple[Array, Array]:
        return linemod.detections(found.cam_from_obj, found.strength, self.model)


def peer(method: str, dataset: ShardDataset, frames: Sequence[int], work: Path) -> Predictions:
    """What the method of METHODS finds on frames of a dataset; `work` keeps what two methods share."""
    kind = PointPairs if method.startswith("PPF") else Linemod
    return kind(dataset, frames, work / kind.__name__.lower()).predictions(method.endswith("+PP"))
