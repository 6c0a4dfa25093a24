"""gt.json and preds.json: what was there, and what somebody says was there.

``binpose-gt/1``::

    {"format", "frame", "visibility": share, "object": {...},
     "images": [{"id", "camera", "instances": [{"R", "t", "visibility", "visibility_SHARE"}]}]}

``binpose-preds/1``::

    {"format", "frame", "object": name or {"name", "diameter", "box_center"},
     "images": [{"id", "time_s", "hypotheses": [{"R", "t", "score"}]}]}

The object's name is null where nobody stated one; it then matches any. "box_center" is the center of the box around
its mesh: it says which frame of the object the poses map from. R (3x3) and t (meters) are ``cam_from_obj``.
"frame" is "camera" (the default) or "world"; "world" says that an adapter knew no camera and left the poses as they
were published, ``world_from_obj``. Unknown fields are let pass, but for a unit other than meters.

"visibility" says which share an instance's "visibility" is, "geometric" or "returned" (see
:class:`evalkit.datasets.scene.Instances`); null where nobody stated it. Where the document holds the other share as
well, each instance has it in "visibility_returned" or "visibility_geometric".
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.datasets.object_reference import LARGEST, checked_reference
from evalkit.datasets.pose_rows import Layout, Rows, checked_poses, first_fault, row_dicts, to_arrays
from evalkit.datasets.scene import Share
from evalkit.datasets.stated_unit import require_meters
from evalkit.datasets.visibility_fields import FIELDS, are_shares, other_share, read_share, share_fields
from evalkit.errors import InputError, shortened
from evalkit.geometry.camera import Camera
from evalkit.json_file import load_json
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]
GT_FORMAT = "binpose-gt/1"
PREDS_FORMAT = "binpose-preds/1"
FRAMES = ("camera", "world")


@dataclass(frozen=True, eq=False)
class GroundTruthImage:
    """The n instances of one image.

    Attributes:
        cam_from_obj: (n, 4, 4), meters.
        visibility: (n,) visible share of each silhouette, 0 to 1; which of the two, the document says.
        other_visibility: (n,) the other share, None where it is not known.
    """

    id: str
    camera: Camera | None
    cam_from_obj: Array
    visibility: Array
    other_visibility: Array | None = None


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """A gt.json; `source` names it in messages, `remarks` say in sentences what its reader had to assume.

    `share` says which share the images' `visibility` is; None where nobody stated it.
    """

    object: ObjectModel
    images: list[GroundTruthImage]
    frame: str = "camera"
    source: str = "the ground truth"
    remarks: tuple[str, ...] = ()
    share: Share | None = None


@dataclass(frozen=True, eq=False)
class PredictionImage:
    """The n hypotheses on one image.

    Attributes:
        cam_from_obj: (n, 4, 4), meters.
        score: (n,) higher is surer, on any scale.
        time_s: seconds spent on the image, where known.
    """

    id: str
    cam_from_obj: Array
    score: Array
    time_s: float | None = None


@dataclass(frozen=True, eq=False)
class Predictions:
    """A preds.json; `object` is the object's name, or a document that may hold "name", "diameter", "box_center"."""

    object: dict[str, Any] | str
    images: list[PredictionImage]
    frame: str = "camera"
    source: str = "the predictions"

    @property
    def object_name(self) -> str:
        """Empty where nobody named the object."""
        return self.object if isinstance(self.object, str) else str(self.object.get("name") or "")

    @property
    def box_center(self) -> Array | None:
        """Center (3,) of the box around the mesh, in the frame that the poses map from; None where it is not stated."""
        center = None if isinstance(self.object, str) else self.object.get("box_center")
        return None if center is None else np.array(center, float)


_GT = Layout(GT_FORMAT, "instances", "instance", "visibility", tuple(FIELDS.values()))
_PREDS = Layout(PREDS_FORMAT, "hypotheses", "hypothesis", "score")


def read_ground_truth(path: Path | str) -> GroundTruth:
    """Read a gt.json.

    Raises:
        InputError: it is no valid document; the sentence names file, image and field.
        OSError: the file cannot be read.
    """
    document = _read(path, _GT)
    model = ObjectModel.from_json(document.get("object"), f"{path}: object")
    entries = _entries(path, document, _GT)
    if not entries:
        raise InputError(f"{path}: the list 'images' is empty; there is nothing to evaluate on.")
    ids, rows = [entry["id"] for entry in entries], [entry["instances"] for entry in entries]
    bad = [i for i, row in enumerate(rows) if not all(map(are_shares, (row.value, *row.optional.values())))]
    if bad:
        raise InputError(f"{path}: image '{ids[bad[0]]}': every 'visibility' must lie between 0 and 1.")
    cameras = [_camera(path, entry) for entry in entries]
    poses = checked_poses(_places(path, ids), rows, _GT, model.centroid)
    share = read_share(path, document)
    others = [other_share(row, share) for row in rows]
    images = [GroundTruthImage(*parts) for parts in zip(ids, cameras, poses, _values(rows), others, strict=True)]
    return GroundTruth(model, images, _frame(path, document), str(path), share=share)


def read_predictions(path: Path | str) -> Predictions:
    """Read a preds.json.

    Raises:
        InputError: it is no valid document; the sentence names file, image and field.
        OSError: the file cannot be read.
    """
    document = _read(path, _PREDS)
    entries = _entries(path, document, _PREDS)
    ids, rows = [entry["id"] for entry in entries], [entry["hypotheses"] for entry in entries]
    times = [_time(path, entry) for entry in entries]
    blank = Predictions(checked_reference(path, document.get("object")), [], _frame(path, document), str(path))
    poses = checked_poses(_places(path, ids), rows, _PREDS, blank.box_center)
    images = [PredictionImage(*parts) for parts in zip(ids, poses, _values(rows), times, strict=True)]
    return replace(blank, images=images)


def write_ground_truth(path: Path | str, truth: GroundTruth) -> None:
    """Write a gt.json atomically, one image a line; reading it back gives the same numbers bit for bit."""
    model = _object_document(truth.object)
    head = {"format": GT_FORMAT, "frame": truth.frame, "visibility": truth.share, "object": model}
    lines = (
        {
            "id": image.id,
            "camera": None if image.camera is None else image.camera.to_json(),
            "instances": row_dicts(
                image.cam_from_obj, **share_fields(image.visibility, image.other_visibility, truth.share)
            ),
        }
        for image in truth.images
    )
    _write(path, head, lines)


def write_predictions(path: Path | str, predictions: Predictions) -> None:
    """Write a preds.json atomically, one image a line; reading it back gives the same numbers bit for bit."""
    head = {"format": PREDS_FORMAT, "frame": predictions.frame, "object": predictions.object or None}
    lines = (
        {"id": image.id, "time_s": image.time_s, "hypotheses": row_dicts(image.cam_from_obj, score=image.score)}
        for image in predictions.images
    )
    _write(path, head, lines)


def _object_document(model: ObjectModel) -> dict[str, Any]:
    """With the mesh's vertices, all digits of them: ADD, MSSD and their kin run over these, wherever the file goes."""
    return model.to_json() | {"vertices": None if model.vertices is None else model.finite_vertices.tolist()}


def _read(path: Path | str, layout: Layout) -> dict[str, Any]:
    def compact(entry: dict[str, Any]) -> dict[str, Any]:
        """Turn an image's rows into arrays while the file is parsed: a tenth of the memory."""
        rows = entry.get(layout.rows)
        if isinstance(rows, list) and "id" in entry:
            arrays = to_arrays(rows, layout)
            entry[layout.rows] = rows if arrays is None else arrays
        return entry

    document = load_json(path, compact)
    if not isinstance(document, dict) or document.get("format") != layout.format:
        found = document.get("format") if isinstance(document, dict) else type(document).__name__
        raise InputError(f"{path}: 'format' must be \"{layout.format}\", found {shortened(found)}.")
    require_meters(document, str(path))
    require_meters(document.get("object"), f"{path}: object")
    return document


def _entries(path: Path | str, document: dict[str, Any], layout: Layout) -> list[dict[str, Any]]:
    """The images, each with a unique id and its rows as arrays."""
    images = document.get("images")
    if not isinstance(images, list):
        raise InputError(f"{path}: the field 'images' must be a list.")
    seen: set[str] = set()
    for index, entry in enumerate(images):
        if not isinstance(entry, dict):
            raise InputError(f"{path}: image {index} must be an object with 'id' and '{layout.rows}'.")
        name = entry.get("id")
        if not isinstance(name, str) or not name:
            raise InputError(f"{path}: image {index}: the field 'id' must be a text that is not empty.")
        if name in seen:
            raise InputError(f"{path}: image '{name}': the 'id' occurs twice; give each image one entry.")
        seen.add(name)
        require_meters(entry, f"{path}: image '{name}'")
        if not isinstance(entry.get(layout.rows), Rows):
            raise InputError(f"{path}: image '{name}': {first_fault(entry.get(layout.rows), layout)}")
    return images


def _places(path: Path | str, ids: list[str]) -> list[str]:
    return [f"{path}: image '{name}'" for name in ids]


def _values(rows: Sequence[Rows]) -> list[Array]:
    return [row.value for row in rows]


def _camera(path: Path | str, entry: dict[str, Any]) -> Camera | None:
    document = entry.get("camera")
    where = f"{path}: image '{entry['id']}': camera"
    if not isinstance(document, dict):
        return None if document is None else Camera.from_json(document, where)
    try:
        return _known_camera(tuple(sorted(document.items())))
    except (InputError, TypeError):
        return Camera.from_json(document, where)


@lru_cache(maxsize=1024)
def _known_camera(items: tuple[tuple[str, Any], ...]) -> Camera:
    """Images share few cameras: check each once."""
    return Camera.from_json(dict(items))


def _time(path: Path | str, entry: dict[str, Any]) -> float | None:
    time_s = entry.get("time_s")
    if time_s is None:
        return None
    if isinstance(time_s, bool) or not isinstance(time_s, int | float) or not 0 <= time_s <= LARGEST:
        raise InputError(f"{path}: image '{entry['id']}': the field 'time_s' must be seconds, zero or more.")
    return float(time_s)


def _frame(path: Path | str, document: dict[str, Any]) -> str:
    frame = document.get("frame", "camera")
    if frame not in FRAMES:
        raise InputError(f'{path}: \'frame\' must be "camera" or "world", found {shortened(frame)}.')
    return str(frame)


def _write(path: Path | str, head: dict[str, Any], images: Iterable[dict[str, Any]]) -> None:
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        file.write(json.dumps(head, allow_nan=False)[:-1] + ', "images": [')
        separator = "\n"
        for image in images:
            file.write(separator + json.dumps(image, allow_nan=False))
            separator = ",\n"
        file.write("\n]}\n")
