"""What `posenet predict` does with each kind of source."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from evalkit.camera import Camera
from evalkit.documents import write_predictions
from evalkit.errors import InputError
from evalkit.shards import ShardDataset
from posenet.images import read_depth
from posenet.picture import draw_predictions, write_picture
from posenet.predict import PredictedPoses, Predictor, to_document

BATCH = 4


def predict_shards(model: Path, source: Path, out: Path, options: dict[str, Any]) -> str:
    """Predict on the depth images of shards; their labels are never read."""
    predictor = Predictor.load(model, options["device"], options["refine"])
    dataset = ShardDataset(source)
    count = min(options["max_images"] or len(dataset), len(dataset))
    numbers = np.linspace(0, len(dataset) - 1, count).round().astype(int)
    found = list(tqdm(_over_shards(predictor, dataset, numbers), total=count, desc="predict", unit=" images"))
    write_predictions(out, to_document(predictor.model, iter(found)))
    if options["picture"] and found:
        reader, row = dataset.locate(int(numbers[0]))
        depth = reader.depth_raw(row) * np.float32(dataset.header.depth_unit)
        _draw(predictor, depth, dataset.header.camera, found[0][1], options)
    return _report(out, found)


def _over_shards(
    predictor: Predictor, dataset: ShardDataset, numbers: np.ndarray[Any, Any]
) -> Iterator[tuple[str, PredictedPoses]]:
    header = dataset.header
    for start in range(0, len(numbers), BATCH):
        located = [dataset.locate(int(number)) for number in numbers[start : start + BATCH]]
        depths = [reader.depth_raw(row) * np.float32(header.depth_unit) for reader, row in located]
        names = [reader.image_id(row) for reader, row in located]
        yield from zip(names, predictor.predict_batch(depths, header.camera), strict=True)


def predict_image(model: Path, source: Path, out: Path, options: dict[str, Any]) -> str:
    """Predict on one depth image file."""
    if options["camera_file"] is None:
        raise InputError(f"{source}: a depth image needs its camera: give --camera camera.json.")
    camera = Camera.load(options["camera_file"])
    depth = read_depth(source, options["depth_unit"])
    predictor = Predictor.load(model, options["device"], options["refine"])
    poses = predictor.predict(depth, camera)
    write_predictions(out, to_document(predictor.model, iter([(source.stem, poses)])))
    if options["picture"]:
        _draw(predictor, depth, camera, poses, options)
    return _report(out, [(source.stem, poses)])


def _draw(
    predictor: Predictor, depth: np.ndarray[Any, Any], camera: Camera, poses: PredictedPoses, options: dict[str, Any]
) -> None:
    picture = draw_predictions(depth, camera, predictor.model, poses, options["picture_score"])
    write_picture(options["picture"], picture)


def _report(out: Path, found: list[tuple[str, PredictedPoses]]) -> str:
    count = sum(len(poses.score) for _, poses in found)
    seconds = sum(poses.time_s for _, poses in found) / max(len(found), 1)
    return f"{out}: {count} hypotheses on {len(found)} images, {seconds * 1e3:.0f} ms an image"
