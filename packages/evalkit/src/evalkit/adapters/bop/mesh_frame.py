"""Between BOP's model frame and the frame of the mesh it was made from, for sets that `simgen export bop` wrote.

BOP puts a model's origin at the center of its bounding box; a mesh file has it anywhere. Such a set's models_info.json
says where the one lies in the other, in millimeters: ``"origin_in_mesh": [x, y, z]``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop.object import METERS
from evalkit.adapters.bop.scenes import dataset_folder
from evalkit.adapters.fields import numbers
from evalkit.datasets.documents import GroundTruth, Predictions
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.json_file import load_json

Array = NDArray[np.float64]
ORIGIN = "origin_in_mesh"


def read_origin(models_info: Path, object_id: int) -> Array:
    """The model's origin (3,) in the mesh's frame, meters.

    Raises:
        InputError: the file does not say.
    """
    document = load_json(models_info)
    entry: Any = document.get(str(object_id)) if isinstance(document, dict) else None
    if not isinstance(entry, dict) or ORIGIN not in entry:
        raise InputError(
            f"{models_info}: states no '{ORIGIN}' of object {object_id}; give the file of a set that "
            "'simgen export bop' wrote, or leave poses in BOP's frame."
        )
    return numbers(entry, ORIGIN, (3,), f"{models_info}: object '{object_id}'") * METERS


def stated_origins(split: Path) -> Path | None:
    """The models_info.json of a split or scene that states where origins lie in meshes; None where none does."""
    dataset = dataset_folder(split / "scene")
    for path in [] if dataset is None else sorted(dataset.glob("models*/models_info.json")):
        document = load_json(path)
        if isinstance(document, dict) and any(isinstance(of, dict) and ORIGIN in of for of in document.values()):
            return path
    return None


def truth_in_mesh_frame(truth: GroundTruth, origin: Array) -> GroundTruth:
    """The same ground truth with the object in the frame of its mesh."""
    model_from_mesh = poses.from_rotation_translation(np.eye(3), -origin)
    images = [replace(image, cam_from_obj=image.cam_from_obj @ model_from_mesh) for image in truth.images]
    return replace(truth, object=truth.object.with_origin(-origin), images=images)


def predictions_in_mesh_frame(predictions: Predictions, origin: Array) -> Predictions:
    """The same poses, of the mesh; the document says where the mesh's box is centered."""
    reference = {"name": predictions.object_name, "box_center": origin.tolist()}
    return replace(_shifted(predictions, -origin), object=reference)


def predictions_in_bop_frame(predictions: Predictions, origin: Array) -> Predictions:
    """The same poses, of BOP's model."""
    return _shifted(predictions, origin)


def _shifted(predictions: Predictions, origin: Array) -> Predictions:
    shift = poses.from_rotation_translation(np.eye(3), origin)
    images = [replace(image, cam_from_obj=image.cam_from_obj @ shift) for image in predictions.images]
    return replace(predictions, images=images)
