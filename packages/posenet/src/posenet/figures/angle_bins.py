"""What the three angles and their bins mean: the object as seen at the bins' centers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.drawing.plots import INK, new_figure
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel, sample_surface_with_normals
from posenet.coding import euler
from posenet.coding.class_bins import Bins
from posenet.network.pose_network import PoseNetwork

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

THUMBNAIL = 72  # pixels
SURFACE_POINTS = 30_000
MOST_COLUMNS = 10
DEGREES = 180 / np.pi
WORDS = (
    "R = Rz(a) · Ry(b) · Rz(c), from the object's canonical frame (z: its symmetry axis, where it has one) to the\n"
    "frame of the ray through its center.  c spins the object about its own z, b tilts that z away from the viewing\n"
    "ray, a turns the image in its plane.  So b and c say from where the object is seen, a how the camera is held."
)


def draw_bins(network: PoseNetwork) -> Figure:
    """The bins of b and c as a sheet of views at a = 0, and below it a row that shows what a does."""
    surface = _Surface(network)
    a, b, c = network.codec.angle_bins
    columns = _some(c, MOST_COLUMNS)
    sheet = [[surface.seen(0.0, _center(b, row), _center(c, column)) for column in columns] for row in range(b.count)]
    turns = [surface.seen(_center(a, turn), _center(b, b.count // 2), 0.0) for turn in _some(a, MOST_COLUMNS)]
    figure = new_figure(10.5, 0.98 * (b.count + 1) + 2.0)
    figure.suptitle(f"{network.model.title}: the angle bins\n\n{WORDS}", fontsize=10, color=INK, x=0.01, ha="left")
    upper, lower = figure.subplots(2, 1, height_ratios=[b.count, 1.0])
    _show(upper, sheet, f"spin c: {len(columns)} of {c.count} bins of {c.width * DEGREES:.3g}°", c, columns)
    upper.set_ylabel(f"tilt b: {b.count} bins of {b.width * DEGREES:.3g}°", color=INK)
    upper.set_yticks(
        THUMBNAIL * (np.arange(b.count) + 0.5), [f"{_center(b, row) * DEGREES:.0f}°" for row in range(b.count)]
    )
    words = f"in-plane a: {len(turns)} of {a.count} bins of {a.width * DEGREES:.3g}°, at b = "
    _show(lower, [turns], words + f"{_center(b, b.count // 2) * DEGREES:.0f}°, c = 0", a, _some(a, MOST_COLUMNS))
    lower.set_yticks([])
    return figure


def _center(bins: Bins, index: int) -> float:
    return bins.low + (index + 0.5) * bins.width


def _some(bins: Bins, most: int) -> list[int]:
    return [int(i) for i in np.linspace(0, bins.count, min(most, bins.count), endpoint=False)]


def _show(axes: Axes, sheet: list[list[NDArray[np.float64]]], label: str, bins: Bins, columns: list[int]) -> None:
    axes.imshow(np.block(sheet), cmap="gray", vmin=0, vmax=1)
    ticks = [f"{_center(bins, column) * DEGREES:.0f}°" for column in columns]
    axes.set_xticks(THUMBNAIL * (np.arange(len(columns)) + 0.5), ticks)
    axes.set_xlabel(label, color=INK)
    axes.tick_params(length=0, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)


class _Surface:
    """Points and normals of the object in its canonical frame, to look at from anywhere."""

    def __init__(self, network: PoseNetwork) -> None:
        points, normals = _sampled(network.model)
        frame = network.codec.canonical_from_obj
        self.points = poses.apply(frame, points) / network.model.diameter
        self.normals = normals @ frame[:3, :3].T

    def seen(self, a: float, b: float, c: float) -> NDArray[np.float64]:
        """A shaded view (THUMBNAIL, THUMBNAIL), 0 to 1, along +z from far away; the ground is white."""
        rotation = euler.from_angles(*torch.tensor([a, b, c], dtype=torch.float64)).numpy()
        points, normals = self.points @ rotation.T, self.normals @ rotation.T
        order = np.argsort(-points[:, 2])  # the far ones first, so that the near ones stay
        pixel = np.floor((points[order, :2] + 0.5) * THUMBNAIL).astype(int).clip(0, THUMBNAIL - 1)
        light = normals[order] @ np.array([-0.35, -0.55, -0.76])
        image = np.ones((THUMBNAIL, THUMBNAIL), np.float32)
        image[pixel[:, 1], pixel[:, 0]] = 0.2 + 0.65 * light.clip(0, 1)
        return np.asarray(cv2.medianBlur(image, 3), float)  # what shines through between two points is gone


def _sampled(model: ObjectModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if model.vertices is None or model.faces is None:
        raise InputError(f"object '{model.title}' has no mesh in the model file, so its views cannot be drawn.")
    return sample_surface_with_normals(model.vertices, model.faces, SURFACE_POINTS)
