"""Whether predictions and ground truth belong together: the same object, images, frame and unit."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import GroundTruth, Predictions
from evalkit.errors import InputError, shortened
from evalkit.objects.model import ObjectModel

BOP_NUMBER = re.compile(r"obj_\d+")
DIAMETER_TOLERANCE = 0.01  # of the diameter: two libraries' readings of one mesh agree far better, two units never
ORIGIN_TOLERANCE = 0.01  # of the diameter: a decimated mesh's box is centered nearly where the mesh's is
IMPLAUSIBLE_RATIO = 100.0  # a hypothesis this many times farther than every instance is in another unit


def require_same_subject(predictions: Predictions, truth: GroundTruth) -> None:
    """Check that the documents speak of the same object, images, frame and unit.

    Raises:
        InputError: they do not; the sentence names both files.
    """
    where = f"{predictions.source}: "
    if _are_of_different_objects(predictions.object_name, truth.object.name):
        raise InputError(
            f"{where}its object is {shortened(predictions.object_name)} but {truth.source} is about "
            f"{shortened(truth.object.name)}; "
            "where they are one, give it one name: 'evalkit gt --object NAME', or 'simgen build --name NAME'."
        )
    diameter = predictions.object.get("diameter") if isinstance(predictions.object, dict) else None
    if diameter is not None and abs(diameter / truth.object.diameter - 1.0) > DIAMETER_TOLERANCE:
        raise InputError(
            f"{where}its object's 'diameter' is {diameter:g} m but that of {truth.source} is "
            f"{truth.object.diameter:g} m; evaluate on ground truth of the same object."
        )
    _require_same_origin(predictions, truth)
    if predictions.frame != truth.frame:
        raise InputError(
            f"{where}its poses are in the {predictions.frame} frame but those of {truth.source} are in the "
            f"{truth.frame} frame; convert both with the same --camera-params."
        )
    known = {image.id for image in truth.images}
    unknown = next((image.id for image in predictions.images if image.id not in known), None)
    if unknown is not None:
        raise InputError(f"{where}image '{unknown}' is not in {truth.source}; use the ground truth of the same images.")
    _require_same_unit(predictions, truth)


def _are_of_different_objects(name: str, other: str) -> bool:
    """Whether both names were stated and differ; BOP's number of an object says nothing against a name."""
    is_number = [BOP_NUMBER.fullmatch(one) is not None for one in (name, other)]
    return bool(name and other) and name != other and is_number[0] == is_number[1]


def _require_same_origin(predictions: Predictions, truth: GroundTruth) -> None:
    """The object's frame must be one: a set in BOP's format may have moved it."""
    center, other = predictions.box_center, truth.object.box_center
    if center is None or other is None:
        return
    apart = float(np.linalg.norm(center - other))
    if apart > ORIGIN_TOLERANCE * truth.object.diameter:
        raise InputError(
            f"{predictions.source}: its poses are of an object frame whose origin lies {1e3 * apart:.3g} mm from that "
            f"of {truth.source}; for a set by 'simgen export bop' give 'evalkit gt --mesh-frame', and for results in "
            "BOP's format 'evalkit preds --models-info'."
        )


def _require_same_unit(predictions: Predictions, truth: GroundTruth) -> None:
    model = truth.object
    reach = max((_reach(image.cam_from_obj, model) for image in truth.images), default=0.0)
    limit = IMPLAUSIBLE_RATIO * max(reach, model.diameter)
    far = next((image for image in predictions.images if _reach(image.cam_from_obj, model) > limit), None)
    if far is not None:
        away = _reach(far.cam_from_obj, model)
        raise InputError(
            f"{predictions.source}: image '{far.id}': the field 't' puts the object {away:g} m away where nothing in "
            f"{truth.source} lies beyond {reach:g} m; give meters, not millimeters."
        )


def _reach(pose: NDArray[np.float64], model: ObjectModel) -> float:
    """The largest coordinate of the parts' centroids; their frame's origin may lie anywhere."""
    return float(np.abs(model.centers(pose)).max(initial=0.0))
