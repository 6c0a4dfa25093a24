"""A contact sheet of shards: depth in millimeters, instances with their visibility, outlines and axes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.drawing.overlays import draw_poses, shade
from evalkit.drawing.plots import INK, new_figure
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

Image = NDArray[np.uint8]
AXIS_COLORS = ((60, 60, 235), (70, 190, 70), (235, 130, 40))  # BGR of x, y, z
SYMMETRY_COLOR = (230, 60, 230)
AXIS_LENGTH = 0.35  # diameters
SUPERSAMPLING = 2  # of the drawn column
COLUMN_INCHES = 4.6


def contact_sheet(dataset: ShardDataset, frames: Sequence[int]) -> Figure:
    """One row for each of `frames`: depth with a color bar, instances, outlines and axes."""
    model, camera = dataset.header.object, dataset.header.camera
    row_inches = COLUMN_INCHES * camera.height / camera.width + 0.35
    figure = new_figure(3 * COLUMN_INCHES + 0.8, row_inches * len(frames) + 0.6)
    columns = figure.subplots(len(frames), 3, squeeze=False)
    for axes, frame in zip(columns, frames, strict=True):
        view: View = dataset[frame]
        _draw_depth(axes[0], view)
        _draw_instances(axes[1], view)
        _draw_poses(axes[2], view, model)
    figure.suptitle(f"{model.title}: {_caption(dataset)}", x=0.01, ha="left", color=INK)
    return figure


def spread_frames(dataset: ShardDataset, count: int) -> list[int]:
    """Up to `count` frames, of as many different scenes as there are, their views differing too."""
    scenes = dataset.scene_index
    _, first, views = np.unique(scenes, return_index=True, return_counts=True)
    chosen = np.unique(np.linspace(0, len(first) - 1, min(count, len(first))).round().astype(int))
    frames = [int(first[scene] + number % views[scene]) for number, scene in enumerate(chosen)]
    others = [frame for frame in range(len(dataset)) if frame not in set(frames)]
    return sorted(frames + others[: max(0, count - len(frames))])


def _caption(dataset: ShardDataset) -> str:
    model = dataset.header.object
    return (
        f"diameter {1e3 * model.diameter:.4g} mm, symmetry {model.symmetry.name}; "
        f"{len(np.unique(dataset.scene_index))} scenes, {len(dataset)} frames"
    )


def _draw_depth(axes: Axes, view: View) -> None:
    depth = 1e3 * view.depth
    known = depth > 0
    objects = known & (view.instance_id > 0)
    of_interest = depth[objects if objects.any() else known]
    near, far = np.percentile(of_interest, [0.5, 99.5]) if of_interest.size else (0.0, 1.0)
    margin = 0.05 * (far - near)
    shown = axes.imshow(np.where(known, depth, np.nan), cmap="viridis_r", vmin=near - margin, vmax=far + margin)
    axes.set_facecolor("black")
    bar = axes.figure.colorbar(shown, ax=axes, extend="both", shrink=0.9, pad=0.02)
    bar.set_label("depth, mm (black: no return)")
    _finish(axes, f"scene {view.scene_index}, view {view.view_index}")


def _draw_instances(axes: Axes, view: View) -> None:
    gray = shade(view.depth, view.camera)[..., ::-1] / 255.0
    palette = instance_colors(int(view.instances.instance.max(initial=0)) + 1)
    inside = view.instance_id > 0
    picture = gray.copy()
    picture[inside] = 0.75 * palette[view.instance_id[inside] - 1] + 0.25 * gray[inside]
    axes.imshow(picture)
    for instance, visibility, pixels in zip(
        view.instances.instance, view.instances.visibility_geometric, view.instances.pixels_geometric, strict=True
    ):
        if pixels:
            v, u = np.nonzero(view.instance_id == instance + 1)
            halo = [withStroke(linewidth=2, foreground="black")]
            axes.text(
                np.median(u), np.median(v), f"{visibility:.2f}", color="white", fontsize=7, ha="center", va="center",
                path_effects=halo,
            )  # fmt: skip
    hidden = int((view.instances.pixels_geometric == 0).sum())
    _finish(axes, f"{len(view.instances)} instances, visibility" + (f"; {hidden} hidden" if hidden else ""))


def _draw_poses(axes: Axes, view: View, model: ObjectModel) -> None:
    shown = view.instances[view.instances.pixels_geometric > 0]
    palette = 255 * instance_colors(int(view.instances.instance.max(initial=0)) + 1)[shown.instance, ::-1]
    colors = [(int(b), int(g), int(r)) for b, g, r in palette]
    picture = draw_poses(view.depth, view.camera, model, shown.cam_from_obj, colors, SUPERSAMPLING)
    large = view.camera.resized(view.camera.width * SUPERSAMPLING, view.camera.height * SUPERSAMPLING)
    for pose in shown.cam_from_obj[np.argsort(-model.centers(shown.cam_from_obj)[:, 2])]:
        draw_axes(picture, large, model, pose)
    axes.imshow(picture[..., ::-1])
    marked = "" if model.symmetry.kind == "sphere" or model.symmetry.name == "none" else ", symmetry axis magenta"
    _finish(axes, f"outlines; axes x red, y green, z blue{marked}")


def draw_axes(picture: Image, camera: Camera, model: ObjectModel, cam_from_obj: NDArray[np.float64]) -> None:
    """Draw into `picture` the object's axes, from its centroid, and through it the main axis of its symmetry."""
    length = AXIS_LENGTH * model.diameter
    symmetry = model.symmetry
    lines = [
        (model.centroid, model.centroid + length * axis, color)
        for axis, color in zip(np.eye(3), AXIS_COLORS, strict=True)
    ]
    if symmetry.name != "none" and symmetry.kind != "sphere":
        reach = 1.6 * length * symmetry.axis
        lines.insert(0, (model.centroid - reach, model.centroid + reach, SYMMETRY_COLOR))
    for start, end, color in lines:
        ends = poses.apply(cam_from_obj, np.stack([start, end]))
        if (ends[:, 2] > 0).all():
            a, b = np.clip(camera.project(ends), -1e5, 1e5).round().astype(int)
            cv2.line(picture, tuple(a.tolist()), tuple(b.tolist()), color, SUPERSAMPLING, cv2.LINE_AA)


def instance_colors(count: int) -> NDArray[np.float64]:
    """RGB colors (count, 3) in 0…1; neighbors in number are far apart in hue (golden angle)."""
    number = np.arange(count)
    hue = (0.08 + number * 0.618034) % 1.0
    return np.asarray(hsv_to_rgb(np.stack([hue, 0.75 - 0.3 * (number % 2), np.ones(count)], -1)))


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=9, loc="left", color=INK)
    axes.set_xticks([])
    axes.set_yticks([])
