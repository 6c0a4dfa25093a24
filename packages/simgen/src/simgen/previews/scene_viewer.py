"""One scene in three dimensions, inside a page: what `scene_viewer.js` needs to draw it in WebGL, as JSON."""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from typing import Any

import fast_simplification
import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from evalkit.datasets.scene import View
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from simgen.config_sections import BinSize
from simgen.previews.sheet import instance_colors

MAX_FACES = 3000  # of the drawn mesh
MAX_POINTS = 16_000  # of the scene's depth images together
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]


def viewer_script() -> str:
    """The JavaScript that draws every ``<canvas class="scene">`` from the JSON element after it."""
    return files("simgen.previews").joinpath("scene_viewer.js").read_text(encoding="utf-8")


def scene_json(views: list[View], model: ObjectModel, bin_size: BinSize | None = None) -> Markup:
    """What the script draws a scene from, safe inside a page's JSON element.

    Args:
        views: of one scene; the instances are drawn where the first one's labels say, and the depth of all as points.
        bin_size: the scene's bin, where it is known.
    """
    document = json.dumps(scene_document(views, model, bin_size), separators=(",", ":"))
    return Markup(document.replace("<", "\\u003c"))


def scene_document(views: list[View], model: ObjectModel, bin_size: BinSize | None = None) -> dict[str, Any]:
    """Arrays as base64 of little-endian float32 or uint32; matrices row by row; lengths in meters.

    The drawn mesh's frame is the object's, moved to the centroid: what looks for the heap looks at translations, and
    float32 has no digits to lose to a file's far origin.
    """
    first = views[0]
    labels = first.instances
    vertices, faces = drawn_mesh(model)
    obj_from_mesh = poses.from_rotation_translation(np.eye(3), model.centroid)
    points, numbers = measured_points(views)
    palette = np.concatenate([[[0.55, 0.58, 0.62]], instance_colors(int(labels.instance.max(initial=-1)) + 1)])
    return {
        "vertices": _packed(vertices - model.centroid, "<f4"),
        "faces": _packed(faces, "<u4"),
        "world_from_mesh": _packed(poses.invert(first.cam_from_world) @ labels.cam_from_obj @ obj_from_mesh, "<f4"),
        "colors": _packed(palette[labels.instance + 1], "<f4"),
        "points": _packed(points, "<f4"),
        "point_colors": _packed(palette[np.minimum(numbers, len(palette) - 1)], "<f4"),
        "cam_from_world": _packed(np.stack([view.cam_from_world for view in views]), "<f4"),
        "camera": first.camera.to_json(),
        "bin": None if bin_size is None else _sides(bin_size),
    }


def _sides(size: BinSize) -> dict[str, float]:
    return {"width": size.width, "depth": size.depth, "height": size.height if size.walls else 0.0}


def drawn_mesh(model: ObjectModel) -> Mesh:
    """The object's mesh, of at most about MAX_FACES; empty where the model has none."""
    if model.vertices is None or model.faces is None:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    vertices, faces = model.vertices, np.asarray(model.faces, np.int64)
    if len(faces) > MAX_FACES:
        about_centroid = (vertices - model.centroid).astype(np.float32)
        vertices, faces = fast_simplification.simplify(about_centroid, faces, target_count=MAX_FACES)
        vertices = vertices.astype(float) + model.centroid
    return np.asarray(vertices, float), np.asarray(faces, np.int64)


def measured_points(views: list[View]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (n, 3) in the world frame that the depth images measured, evenly thinned, and their instance + 1 or 0."""
    points, numbers = [], []
    for view in views:
        rows, columns = np.nonzero(view.depth_raw)
        thinned = np.linspace(0, len(rows) - 1, min(len(rows), MAX_POINTS // len(views))).astype(int)
        v, u = rows[thinned], columns[thinned]
        measured = view.camera.unproject(np.stack([u, v], -1), view.depth[v, u])
        points.append(poses.apply(poses.invert(view.cam_from_world), measured))
        numbers.append(view.instance_id[v, u])
    return np.concatenate(points), np.concatenate(numbers).astype(np.int64)


def _packed(array: ArrayLike, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype).tobytes()).decode()
