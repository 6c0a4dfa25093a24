"""What `posenet predict` does."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from tqdm import tqdm

from evalkit.datasets.documents import write_predictions
from posenet.network.predict_options import PredictOptions
from posenet.prediction.picture import draw_predictions, write_picture
from posenet.prediction.predictor import PredictedPoses, Predictor, to_document
from posenet.prediction.sources import DepthSource, open_source

BATCH = 4

Found = list[tuple[str, PredictedPoses]]


def predict(
    model: Path,
    path: Path,
    out: Path,
    camera_file: Path | None = None,
    depth_unit: float | None = None,
    picture: Path | None = None,
    picture_score: float = 0.5,
    max_images: int | None = None,
    device: str = "auto",
    refine: bool = False,
    options: PredictOptions | None = None,
) -> str:
    """Predict on the images at `path`, write `out` and, if asked for, a picture of the first; returns a summary.

    Raises:
        InputError: the model, the images or the device cannot be used.
        OSError: a folder cannot be written; said before the work, not after it.
    """
    source = open_source(path, camera_file, depth_unit)
    predictor = Predictor.load(model, device, refine, options)
    for file in [out] + ([picture] if picture is not None else []):
        _require_writable(file.parent)
    numbers = source.spread(max_images)
    found = list(tqdm(_over(predictor, source, numbers), total=len(numbers), desc="predict", unit=" images"))
    write_predictions(out, to_document(predictor.model, iter(found)))
    if picture is not None and found:
        depth = predictor.clean(source.read(numbers[0]), source.camera)
        write_picture(picture, draw_predictions(depth, source.camera, predictor.model, found[0][1], picture_score))
    return _summary(out, found)


def _over(predictor: Predictor, source: DepthSource, numbers: list[int]) -> Iterator[tuple[str, PredictedPoses]]:
    for start in range(0, len(numbers), BATCH):
        some = numbers[start : start + BATCH]
        names = [source.names[number] for number in some]
        depths = [source.read(number) for number in some]
        yield from zip(names, predictor.predict_batch(depths, source.camera, names), strict=True)


def _require_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


def _summary(out: Path, found: Found) -> str:
    count = sum(len(poses.score) for _, poses in found)
    seconds = sum(poses.time_s for _, poses in found) / max(len(found), 1)
    return f"{out}: {count} hypotheses on {len(found)} images, {seconds * 1e3:.0f} ms an image"
