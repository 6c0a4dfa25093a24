"""What was understood of a mesh, to look at: its surface with its axes, and its convex parts."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evalkit.drawing.overlays import shade
from evalkit.drawing.plots import INK, new_figure
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.objects.convex import Part
from simgen.objects.prepare import PreparedObject, describe
from simgen.previews.sheet import draw_axes, instance_colors
from simgen.rendering.rasterizer import Rasterizer

SIDE = 360  # pixels
DISTANCE = 4.0  # diameters; far enough for little perspective
VIEWS = {
    "from the front (along y)": (0, -1, 0),
    "from the side (along x)": (1, 0, 0),
    "from above": (0, 0, 1),
    "aslant": (1, -1.4, 0.9),
}
Picture = NDArray[np.float64]  # RGB (SIDE, SIDE, 3) in 0…1


def object_sheet(prepared: PreparedObject) -> Figure:
    """Two rows of four views: the surface with axes, the convex parts in colors."""
    model = prepared.model
    focal, middle = 0.92 * DISTANCE * SIDE, (SIDE - 1) / 2
    camera = Camera(SIDE, SIDE, focal, focal, middle, middle)
    figure = new_figure(11.0, 6.0)
    for column, (name, direction) in enumerate(VIEWS.items()):
        pose = _looking_from(np.array(direction, float), model.centroid, DISTANCE * model.diameter)
        pictures = (_draw_surface(camera, prepared, pose), _draw_parts(camera, prepared.convex_parts, pose))
        for row, picture in enumerate(pictures):
            axes = figure.add_subplot(2, len(VIEWS), row * len(VIEWS) + column + 1)
            axes.imshow(picture)
            axes.set_title(name if row == 0 else "", fontsize=9, color=INK)
            axes.set_axis_off()
    figure.suptitle(
        f"{model.name}: diameter {1e3 * model.diameter:.4g} mm; symmetry {describe(prepared.symmetry)}; "
        f"{len(prepared.convex_parts)} convex parts (below)",
        x=0.01, ha="left", fontsize=10, color=INK,
    )  # fmt: skip
    return figure


def _looking_from(direction: NDArray[np.float64], target: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
    """cam_from_obj (4, 4) of a camera at `target` + `distance` along `direction`, z of the object upwards."""
    forward = -direction / np.linalg.norm(direction)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[2]) > 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return poses.from_rotation_translation(rotation, -rotation @ (target - distance * forward))


def _draw_surface(camera: Camera, prepared: PreparedObject, cam_from_obj: NDArray[np.float64]) -> Picture:
    """The lit surface with axes."""
    mesh = (prepared.mesh.vertices, prepared.mesh.faces.astype(np.int32))
    picture = shade(_depth(camera, mesh, cam_from_obj), camera)
    draw_axes(picture, camera, prepared.model, cam_from_obj)
    return picture[..., ::-1] / 255.0


def _depth(camera: Camera, mesh: Part, cam_from_obj: NDArray[np.float64]) -> NDArray[np.float32]:
    return Rasterizer(camera, *mesh).render(cam_from_obj[None], np.eye(4)).depth


def _draw_parts(camera: Camera, parts: list[Part], cam_from_obj: NDArray[np.float64]) -> Picture:
    """Each part in its color, lit like the surface."""
    depths = np.stack([_depth(camera, part, cam_from_obj) for part in parts])
    depths[depths == 0] = np.inf
    nearest = depths.min(0)
    seen = np.isfinite(nearest)
    light = shade(np.where(seen, nearest, 0), camera) / 150.0
    return np.where(seen[..., None], np.clip(instance_colors(len(parts))[depths.argmin(0)] * light, 0, 1), 0.0)
