"""What `posenet predict` does."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import click
import numpy as np
from tqdm import tqdm

from evalkit.adapters.bop import results as bop_results
from evalkit.adapters.bop.mesh_frame import read_origin
from evalkit.datasets.documents import write_predictions
from evalkit.depth.sources import DepthSource
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.commands.next_steps import after_predict
from posenet.network.predict_options import PredictOptions
from posenet.prediction.area_of_interest import AreaOfInterest
from posenet.prediction.pose_picture import draw_predictions, write_picture
from posenet.prediction.predictor import PredictedPoses, Predictor, predict_together, to_document

BATCH = 4
_SAFE = re.compile(r"[^\w.-]+")
SAME_ORIGIN = 0.01  # diameters

Found = list[tuple[str, PredictedPoses]]


def predict(
    model: Path,
    source: DepthSource,
    out: Path,
    picture: Path | None = None,
    picture_score: float = 0.5,
    max_images: int | None = None,
    device: str = "auto",
    precision: str = "auto",
    refine: bool = False,
    options: PredictOptions | None = None,
    area: AreaOfInterest | None = None,
    object_id: int | None = None,
    also: Sequence[Path] = (),
) -> str:
    """Predict on the images of `source`, write `out` and, if asked for, a picture of the first; returns a summary.

    An `out` that ends in .csv becomes BOP's results file, with `object_id` as the object's number. `also` are models of
    other parts in the same bin, whose poses compete with this one's; theirs are written beside `out`.

    Raises:
        InputError: the model, the images, the area or the device cannot be used.
        OSError: a folder cannot be written; said before the work, not after it.
    """
    area = area or AreaOfInterest()
    for camera in dict.fromkeys(source.cameras):
        area.mask(camera)  # refused now, not after an hour
    if also and not refine:
        raise InputError(
            "--also: poses of several parts compete by what the image shows of them; leave out --no-refine."
        )
    predictors = [Predictor.load(file, device, refine, options, precision) for file in (model, *also)]
    predictor, outs = predictors[0], _outs(out, [each.model.name for each in predictors])
    _require_bop_ids(out, source, predictor.model.name, object_id)
    for file in [out] + ([picture] if picture is not None else []):
        _require_writable(file.parent)
    numbers = source.spread(max_images)
    found = list(tqdm(_over(predictors, source, numbers, area), total=len(numbers), desc="predict", unit=" images"))
    parts = [[(name, poses[part]) for name, poses in found] for part in range(len(predictors))]
    for each, file, images in zip(predictors, outs, parts, strict=True):
        document = to_document(each.model, iter(images))
        if _is_bop_csv(file):
            origins = source.models_info if _is_of_its_mesh(source.models_info, each.model, object_id) else None
            remark = bop_results.write_predictions(file, document, object_id=object_id, models_info=origins)
            if remark:
                click.echo(f"Note: {remark}", err=True)
        else:
            write_predictions(file, document)
    if picture is not None and found:
        camera = source.cameras[numbers[0]]
        depth = source.depth(numbers[0])
        write_picture(picture, draw_predictions(depth, camera, predictor.model, found[0][1][0], picture_score))
    after_predict(source.path, out, source.truth, picture is not None, source.truth_options)
    lines = [_summary(file, images) for file, images in zip(outs, parts, strict=True)]
    return "\n".join(f"{line}, layers in {predictor.precision}" for line in lines)


def _outs(out: Path, names: list[str]) -> list[Path]:
    """A file for each part: `out`, and beside it those of other parts by their objects' names.

    Raises:
        InputError: two parts have the same name, or BOP's results are asked of several.
    """
    if len(names) > 1 and _is_bop_csv(out):
        raise InputError(f"{out}: --also writes a preds.json for each part; end the name in .json.")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"--also: two models are of the part '{twice}'; give one model of each part.")
    return [out] + [out.with_name(f"{out.stem}-{_SAFE.sub('_', name)}{out.suffix}") for name in names[1:]]


def _over(
    predictors: Sequence[Predictor], source: DepthSource, numbers: list[int], area: AreaOfInterest
) -> Iterator[tuple[str, tuple[PredictedPoses, ...]]]:
    """The images' names, and the poses of each part in them."""
    for camera, some in _batches(source, numbers):
        names = [source.names[number] for number in some]
        depths = [source.read(number) for number in some]
        found = predict_together(predictors, depths, camera, names, area.mask(camera))
        yield from zip(names, zip(*found, strict=True), strict=True)


def _batches(source: DepthSource, numbers: list[int]) -> Iterator[tuple[Camera, list[int]]]:
    """Numbers of a few images each, in order, that share a camera."""
    for camera, group in groupby(numbers, key=source.cameras.__getitem__):
        same = list(group)
        yield from ((camera, same[start : start + BATCH]) for start in range(0, len(same), BATCH))


def _is_bop_csv(out: Path) -> bool:
    return out.suffix.lower() == ".csv"


def _require_bop_ids(out: Path, source: DepthSource, name: str, object_id: int | None) -> None:
    """Refuse, before the work, what BOP's results file cannot say.

    Raises:
        InputError: the object's number, or the images' scene and number, are not known; or no such file is written.
    """
    if not _is_bop_csv(out):
        if object_id is not None:
            raise InputError(f"{out}: --object-id is for BOP's results file; end the name in .csv.")
        return
    if object_id is None and bop_results.OBJECT_NAME.fullmatch(name) is None:
        raise InputError(f"{out}: BOP knows objects by numbers; give --object-id.")
    strange = next((image for image in source.names if bop_results.IMAGE_ID.fullmatch(image) is None), None)
    if strange is not None:
        raise InputError(
            f"{out}: BOP knows images by scene and number, and '{strange}' has none; give a BOP dataset, or end the "
            "name in .json."
        )


def _is_of_its_mesh(models_info: Path | None, model: ObjectModel, object_id: int | None) -> bool:
    """Whether a model's frame is that of the mesh from which the set's own, centered model was made."""
    name = bop_results.OBJECT_NAME.fullmatch(model.name)
    number = int(name[1]) if object_id is None and name is not None else object_id
    if models_info is None or model.box_center is None or number is None:
        return False
    return float(np.linalg.norm(read_origin(models_info, number) - model.box_center)) < SAME_ORIGIN * model.diameter


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
