"""Our frames as a dataset of the BOP benchmark (Hodaň et al. 2018), which :mod:`evalkit.adapters.bop` reads back.

::

    camera.json  dataset_info.md  test_targets_bop19.json, _bop24.json, _multiview_bop25.json
    models/, models_eval/       obj_000001.ply in millimeters, models_info.json with the symmetries and origin_in_mesh
    SPLIT/SSSSSS/               scene_gt.json, scene_gt_info.json, scene_camera.json
    SPLIT/SSSSSS/depth/         VVVVVV.png, the stored steps; scene_camera.json says how many millimeters one is
    SPLIT/SSSSSS/mask/          VVVVVV_NNNNNN.png, whole silhouettes within the frame; mask_visib/: what is seen of them

S counts scenes, V views of a scene, N instances of a view. Visible is where the instance is the nearest surface,
with a depth return or without, so that counts, masks and our geometric visibility agree. bop_toolkit's own script
counts holes of the depth image as visible, too, but for the instances behind the nearest as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop.mesh_frame import ORIGIN
from evalkit.adapters.bop.object import METERS
from evalkit.adapters.depth_images import write_png
from evalkit.atomic import write_json, write_text
from evalkit.datasets.scene import Instances, View
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.meshes.write import write_ply
from evalkit.objects.extent import largest_distance
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Silhouettes = Callable[[View], Iterable[Mask]]
OBJECT_ID = 1
TARGET_VISIBILITY = 0.1  # BOP looks for instances that are at least so visible
NOWHERE = [-1, -1, -1, -1]  # the box of what has no visible pixel
DATASET_INFO = """\
# {title}

Written by `simgen export bop` (binpose). One object, number 1.

- The model's origin is the center of its bounding box, as the format has it. `{origin}` in models_info.json says where
  in the mesh it was made from that point lies, in millimeters: x_mesh = x_model + {origin}.
- scene_gt_info.json and mask_visib/ are exact: an instance is visible where it is the nearest surface, with a depth
  return or without. bop_toolkit's calc_gt_info.py estimates this from the depth images, with a tolerance of 15 mm: what
  lies up to 15 mm behind the depth, or where depth is missing, counts as visible there.
"""


def write_dataset_files(dataset: Path, model: ObjectModel, camera: Camera, depth_unit: float) -> None:
    """Write what all scenes share: camera.json and the object, once to look at and once to compute errors on.

    The object is moved to where the format has it, with its origin at the center of its bounding box.

    Raises:
        InputError: the object has no mesh.
    """
    origin = origin_in_mesh(model)
    title, model = model.title, model.with_origin(origin)
    assert model.vertices is not None and model.faces is not None
    intrinsics = {key: value for key, value in camera.to_json().items() if key not in ("width", "height")}
    size = {"width": camera.width, "height": camera.height}
    write_json(dataset / "camera.json", intrinsics | size | {"depth_scale": depth_unit / METERS}, indent=2)
    info = _extent(model.finite_vertices / METERS) | _symmetries(model.symmetry, model.centroid / METERS)
    info[ORIGIN] = (origin / METERS).tolist()
    normals = _vertex_normals(model.vertices, model.faces)
    for name in ("models", "models_eval"):
        write_ply(dataset / name / f"obj_{OBJECT_ID:06d}.ply", model.vertices / METERS, model.faces, normals)
        write_json(dataset / name / "models_info.json", {str(OBJECT_ID): info}, indent=2)
    write_text(dataset / "dataset_info.md", DATASET_INFO.format(title=title, origin=ORIGIN))


def origin_in_mesh(model: ObjectModel) -> Array:
    """The point (3,) of the mesh's frame that becomes the origin of BOP's, in meters.

    Raises:
        InputError: the object has no mesh.
    """
    if model.box_center is None or model.faces is None:
        raise InputError(f"object '{model.title}' has no mesh, and BOP knows no object without one.")
    return model.box_center


def write_scene(folder: Path, views: Iterable[View], silhouettes: Silhouettes, origin: Array) -> None:
    """Write one scene's images, masks and labels into the new folder `folder`.

    Args:
        origin: as :func:`origin_in_mesh` gives it.
        silhouettes: gives each instance's whole silhouette within the frame, (height, width), in the labels' order.
    """
    for name in ("depth", "mask", "mask_visib"):
        (folder / name).mkdir(parents=True)
    gt: dict[str, Any] = {}
    info: dict[str, Any] = {}
    cameras: dict[str, Any] = {}
    mesh_from_model = poses.from_rotation_translation(np.eye(3), origin)
    for view in views:
        number, key = view.view_index, str(view.view_index)
        write_png(folder / "depth" / f"{number:06d}.png", view.depth_raw)
        gt[key] = [
            _pose(pose, "cam_R_m2c", "cam_t_m2c") | {"obj_id": OBJECT_ID}
            for pose in view.instances.cam_from_obj @ mesh_from_model
        ]
        cameras[key] = {
            "cam_K": view.camera.matrix.ravel().tolist(),
            "depth_scale": view.depth_unit / METERS,
            **_pose(view.cam_from_world, "cam_R_w2c", "cam_t_w2c"),
        }
        info[key] = []
        returns = view.depth_raw > 0
        for row, silhouette in enumerate(silhouettes(view)):
            visible = view.instance_id == view.instances.instance[row] + 1
            name = f"{number:06d}_{row:06d}.png"
            write_png(folder / "mask" / name, silhouette * np.uint8(255))
            write_png(folder / "mask_visib" / name, visible * np.uint8(255))
            info[key].append(_instance_info(view.instances, row, visible, int((silhouette & returns).sum())))
    for name, document in (("scene_gt", gt), ("scene_gt_info", info), ("scene_camera", cameras)):
        write_json(folder / f"{name}.json", document)


def write_targets(dataset: Path, counted: Iterable[tuple[int, int, Array]]) -> None:
    """Write the lists of targets: for localization (2019), for detection (2024), for several views at once (2025).

    Args:
        counted: scene, view and the geometric visibility (n,) of its instances.
    """
    localization: list[dict[str, int]] = []
    detection: list[dict[str, int]] = []
    views: dict[int, list[int]] = {}
    for scene, view, visibility in counted:
        count = int((np.asarray(visibility) >= TARGET_VISIBILITY).sum())
        if count:
            localization.append({"im_id": view, "inst_count": count, "obj_id": OBJECT_ID, "scene_id": scene})
        detection.append({"im_id": view, "scene_id": scene})
        views.setdefault(scene, []).append(view)
    write_json(dataset / "test_targets_bop19.json", localization)
    write_json(dataset / "test_targets_bop24.json", detection)
    together = [{"im_id": members, "scene_id": scene} for scene, members in views.items()]
    write_json(dataset / "test_targets_multiview_bop25.json", together)


def _pose(pose: Array, rotation: str, translation: str) -> dict[str, list[float]]:
    return {rotation: pose[:3, :3].ravel().tolist(), translation: (pose[:3, 3] / METERS).tolist()}


def _instance_info(labels: Instances, row: int, visible: Mask, pixels_valid: int) -> dict[str, Any]:
    seen = bool(visible.any())
    return {
        "bbox_obj": _box(*labels.box_full[row].tolist()) if seen else NOWHERE,
        "bbox_visib": _box(*_extremes(visible)) if seen else NOWHERE,
        "px_count_all": int(labels.pixels_full[row]),
        "px_count_valid": pixels_valid,
        "px_count_visib": int(labels.pixels_geometric[row]),
        "visib_fract": float(labels.visibility_geometric[row]),
    }


def _box(x0: int, y0: int, x1: int, y1: int) -> list[int]:
    """x0, y0, x1, y1, half-open, to x, y, width, height as bop_toolkit counts them: from first pixel to last."""
    return [x0, y0, x1 - x0 - 1, y1 - y0 - 1]


def _extremes(mask: Mask) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1, half-open, of the pixels of a mask (height, width) that has some."""
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _extent(vertices: Array) -> dict[str, float]:
    """The box of vertices (n, 3), and BOP's diameter, the largest distance of two of them."""
    low, size = vertices.min(0), np.ptp(vertices, axis=0)
    box = {f"min_{axis}": float(low[i]) for i, axis in enumerate("xyz")}
    box |= {f"size_{axis}": float(size[i]) for i, axis in enumerate("xyz")}
    return {"diameter": largest_distance(vertices), **box}


def _symmetries(symmetry: Symmetry, center: Array) -> dict[str, Any]:
    """The group as motions of the model's frame, millimeters: the discrete ones without the identity, the axes."""
    axes: Array
    discrete: Array
    if symmetry.kind == "sphere":
        axes, discrete = np.eye(3)[:2], np.zeros((0, 3, 3))  # two axes generate all rotations
    else:
        axes = symmetry.axis[None] if symmetry.kind == "revolution" else np.zeros((0, 3))
        discrete = symmetry.rotations[1:]
    motions = poses.from_rotation_translation(discrete, center - discrete @ center)
    stated: dict[str, Any] = {}
    if len(motions):
        stated["symmetries_discrete"] = motions.reshape(-1, 16).tolist()
    if len(axes):
        stated["symmetries_continuous"] = [{"axis": axis.tolist(), "offset": center.tolist()} for axis in axes]
    return stated


def _vertex_normals(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Unit normals (V, 3): the means of the adjoining faces', weighted by their area; z where there is no face."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack([np.bincount(faces.ravel(), np.repeat(across[:, i], 3), len(vertices)) for i in range(3)], -1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 0, sums / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 1.0])
