"""BOP's object models: ``models*/obj_000001.ply`` in millimeters and the symmetries that models_info.json states.

BOP's symmetries are rigid motions of the model's frame, and leave out the identity; evalkit's are rotations about the
centroid. They become the same where the centroid is a point that all of them keep, so it is moved to the nearest one.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.fields import numbers
from evalkit.datasets.pose_rows import FARTHEST
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.json_file import load_json
from evalkit.meshes.load import load_object
from evalkit.meshes.units import check_size
from evalkit.objects.model import THRESHOLD_RATIO, ObjectModel
from evalkit.objects.symmetry import Symmetry
from evalkit.objects.symmetry_detection import resolve_symmetry

Array = NDArray[np.float64]
METERS = 1e-3  # a millimeter
MODEL_FOLDERS = ("models_eval", "models", "models_cad", "models_reconst")  # BOP computes errors on the first
SAME_TURN = 0.05  # radians between two elements that are one, written with different rounding
LARGEST_GROUP = 120  # the proper icosahedral group has 60
KEPT = 0.01  # of the diameter: how far a symmetry may carry the point that it should keep
NEARBY = 0.25  # of the diameter: how far that point may be from the surface's centroid
WORTH_A_REMARK = 0.01  # of the diameter


def read_object(
    dataset: Path | None,
    object_id: int,
    name: str | None = None,
    mesh: Path | None = None,
    units: str | None = None,
    symmetry: str | None = None,
) -> tuple[ObjectModel, list[str]]:
    """An object of a BOP dataset, in meters, and remarks on what had to be assumed.

    Args:
        dataset: the folder that holds models*/; None where there is none.
        mesh, units: another mesh of the object, in the same frame, in place of the dataset's.
        symmetry: in place of the dataset's, as :func:`resolve_symmetry` takes it.

    Raises:
        InputError: there is neither a mesh nor models_info.json, or one of them cannot be used.
    """
    name = name or f"obj_{object_id:06d}"
    folder = _model_folder(dataset, object_id)
    info, where = ({}, "") if folder is None else _info(folder, object_id)
    own_mesh = None if folder is None else folder / f"obj_{object_id:06d}.ply"
    remarks: list[str] = []
    if mesh is not None:
        model = load_object(mesh, units, "none", name)
    elif own_mesh is not None and own_mesh.is_file():
        model = load_object(own_mesh, "mm", "none", name)
    elif info:
        model = _box(name, info, where)
        remarks.append(f"{where} stands in for the mesh: the object is taken for its box; give --mesh for its shape.")
    else:
        raise InputError(
            f"object {object_id}: no models/obj_{object_id:06d}.ply here or above; give --mesh and --units."
        )
    of = {} if dataset is None else {"bop_dataset": dataset.name}
    model = replace(model, notes={**model.notes, **of, "bop_obj_id": object_id})
    if info:
        model = _with_bop_threshold(model, info, where)
    if symmetry is not None:
        return model.with_symmetry(_resolved(model, symmetry)), remarks
    if info:
        return _with_stated_symmetry(model, info, where, remarks), remarks
    found = _resolved(model, "auto")
    return model.with_symmetry(found), [*remarks, f"There is no models_info.json: the mesh's symmetry is {found.name}."]


def models_info(dataset: Path | None, object_id: int) -> Path:
    """The file that states an object's symmetries, whether it is there or not."""
    return (_model_folder(dataset, object_id) or (dataset or Path()) / MODEL_FOLDERS[0]) / "models_info.json"


def _model_folder(dataset: Path | None, object_id: int) -> Path | None:
    if dataset is None:
        return None
    folders = [dataset / name for name in MODEL_FOLDERS if (dataset / name).is_dir()]
    with_mesh = [folder for folder in folders if (folder / f"obj_{object_id:06d}.ply").is_file()]
    with_info = [folder for folder in folders if (folder / "models_info.json").is_file()]
    return next(iter(with_mesh + with_info), None)


def _info(folder: Path, object_id: int) -> tuple[dict[str, Any], str]:
    """The object's entry of models_info.json, empty where there is no such file, and its place in words."""
    path = folder / "models_info.json"
    if not path.is_file():
        return {}, ""
    document = load_json(path)
    entry = document.get(str(object_id)) if isinstance(document, dict) else None
    if not isinstance(entry, dict):
        raise InputError(f"{path}: the object '{object_id}' is missing; give another --object-id.")
    return entry, f"{path}: object '{object_id}'"


def _box(name: str, info: dict[str, Any], where: str) -> ObjectModel:
    """The bounding box; without points, for it says nothing about the surface."""
    low = np.array([float(numbers(info, f"min_{axis}", (), where)) for axis in "xyz"]) * METERS
    size = np.array([float(numbers(info, f"size_{axis}", (), where)) for axis in "xyz"]) * METERS
    if (size < 0).any() or (np.abs(low) > FARTHEST).any():
        raise InputError(f"{where}: its 'min' and 'size' are no box in millimeters; mend them, or give --mesh.")
    corners = low + size * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    check_size(float(size.max()), f"{where}: the box of min and size")
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    model = ObjectModel.from_mesh(name, corners, triangles, mesh="the box of models_info.json")
    return replace(model, points=None, vertices=None, faces=None)


def _with_bop_threshold(model: ObjectModel, info: dict[str, Any], where: str) -> ObjectModel:
    """A tenth of BOP's diameter, the largest distance of two vertices, so that its thresholds mean what BOP means."""
    diameter = float(numbers(info, "diameter", (), where)) * METERS
    if not 0.4 <= diameter / model.diameter <= 2.0:
        raise InputError(
            f"{where}: its 'diameter' is {diameter:.4g} m but the mesh's {model.diameter:.4g} m; "
            "the file must be in millimeters, or --units is wrong."
        )
    stated = "a tenth of the diameter that models_info.json states"
    notes = {**model.notes, "threshold": stated, "bop_diameter": diameter}
    return replace(model, threshold=THRESHOLD_RATIO * diameter, notes=notes)


def _resolved(model: ObjectModel, symmetry: str) -> Symmetry:
    if model.vertices is None or model.faces is None:
        return Symmetry.parse("none" if symmetry == "auto" else symmetry)
    return resolve_symmetry(model.vertices, model.faces, symmetry).symmetry


def _with_stated_symmetry(model: ObjectModel, info: dict[str, Any], where: str, remarks: list[str]) -> ObjectModel:
    discrete = _discrete(info, where)
    axes, offsets = _continuous(info, where)
    if len(discrete) + len(axes) == 0:
        return model
    symmetry = symmetry_group(discrete[:, :3, :3], axes, where)
    kept = _kept_point(model.centroid, discrete, axes, offsets)
    carried = np.linalg.norm(poses.apply(discrete, kept[None])[:, 0] - kept, axis=1)
    strayed = np.linalg.norm(np.cross(axes, kept - offsets), axis=1)
    moved = float(np.linalg.norm(kept - model.centroid))
    if max([0.0, *carried, *strayed]) > KEPT * model.diameter or moved > NEARBY * model.diameter:
        raise InputError(f"{where}: its symmetries keep no point near the object's center; are all in millimeters?")
    if moved > WORTH_A_REMARK * model.diameter:
        remarks.append(f"The centroid is moved by {1e3 * moved:.2g} mm to the point that the stated symmetries keep.")
    return _centered_at(model, kept).with_symmetry(symmetry)


def _discrete(info: dict[str, Any], where: str) -> Array:
    """symmetries_discrete as transforms (n, 4, 4), meters."""
    rows = info.get("symmetries_discrete") or []
    transforms = numbers({"symmetries_discrete": rows}, "symmetries_discrete", (-1, 4, 4), where).copy()
    if not poses.is_rotation(transforms[:, :3, :3], 1e-2).all():
        raise InputError(f"{where}: the field 'symmetries_discrete' holds a matrix that is no rigid motion.")
    transforms[:, :3, 3] *= METERS
    return transforms


def _continuous(info: dict[str, Any], where: str) -> tuple[Array, Array]:
    """symmetries_continuous as unit axes (n, 3) and points on them (n, 3), meters."""
    rows = info.get("symmetries_continuous") or []
    if not isinstance(rows, list):
        raise InputError(f"{where}: the field 'symmetries_continuous' must be a list of {{'axis', 'offset'}}.")
    place = f"{where}: symmetries_continuous"
    axes = np.array([numbers(row, "axis", (3,), place) for row in rows]).reshape(-1, 3)
    offsets = np.array([numbers(row, "offset", (3,), place) for row in rows]).reshape(-1, 3)
    lengths = np.linalg.norm(axes, axis=1, keepdims=True)
    if (lengths == 0).any():
        raise InputError(f"{place}: an 'axis' is zero; give its direction.")
    return axes / lengths, offsets * METERS


def symmetry_group(rotations: Array, axes: Array, where: str) -> Symmetry:
    """The proper group that rotations (n, 3, 3) and continuous axes (m, 3) generate.

    Raises:
        InputError: the rotations generate no finite group of sane size.
    """
    if len(axes) == 0:
        return _finite_group(rotations, where)
    images = np.concatenate([axes, rotations @ axes[0]])
    along = np.abs(images @ axes[0])
    if (along < np.cos(SAME_TURN)).any():
        return Symmetry.parse("sphere")  # two axes of revolution generate all rotations
    flips = (images @ axes[0] < 0)[len(axes) :].any()
    frame = poses.rotation_between([0.0, 0.0, 1.0], axes[0])
    return Symmetry.parse("revolution-flip" if flips else "revolution", frame)


def _finite_group(generators: Array, where: str) -> Symmetry:
    """All products of the rotations (n, 3, 3), the identity included."""
    generators = poses.nearest_rotation(generators)
    elements = [np.eye(3)]
    for element in elements:  # grows while it is walked
        for product in element @ generators:
            if poses.rotation_angle(product, np.stack(elements)).min() > SAME_TURN:
                elements.append(product)
        if len(elements) > LARGEST_GROUP:
            break
    else:
        with suppress(InputError):
            return Symmetry.from_rotations(np.stack(elements))
    raise InputError(f"{where}: the field 'symmetries_discrete' generates no finite group; mend its matrices.")


def _kept_point(centroid: Array, discrete: Array, axes: Array, offsets: Array) -> Array:
    """The point nearest to `centroid` that the motions keep, in the least-squares sense."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    system = np.concatenate([discrete[:, :3, :3] - np.eye(3), across]).reshape(-1, 3)
    target = np.concatenate([-discrete[:, :3, 3], np.einsum("nij,nj->ni", across, offsets)]).reshape(-1)
    step, *_ = np.linalg.lstsq(system, target - system @ centroid, rcond=1e-2)
    return np.asarray(centroid + step)


def _centered_at(model: ObjectModel, center: Array) -> ObjectModel:
    turn = model.inertial_from_obj[:3, :3]
    diameter = model.diameter
    if model.vertices is not None and model.faces is not None:
        diameter = 2.0 * float(np.linalg.norm(model.vertices[np.unique(model.faces)] - center, axis=1).max())
    inertial_from_obj = poses.from_rotation_translation(turn, -turn @ center)
    return replace(model, centroid=center, inertial_from_obj=inertial_from_obj, diameter=diameter)
