"""What the joint registration reads of each pair of hypotheses: the 13 relation features as matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.drawing.plots import INK, new_figure
from posenet.figures.looked_at import SCALE, LookedAt
from posenet.network.registration import RELATION_NAMES, HypothesisSet, Relations, relation_features

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DETECTIONS = 5
SIGNED = ("own score", "other's score", "dx", "dy", "dz")  # drawn about 0; the other features are 0 or more
WORDS = """Each matrix is one of the 13 numbers that
the registration reads of every pair.
Row: the hypothesis that listens.
Column: the neighbor it hears.
Lines part the detections; blank pairs
do not overlap, so they do not talk.
Scores are log-odds / 5, angles in [0, 1],
dx, dy, dz over the model box's diagonal."""


def draw_relations(looked: LookedAt) -> Figure:
    """The hypotheses of a few neighboring detections, and a matrix for each feature."""
    groups = _neighboring_groups(looked)
    rows = [row for group in groups for row in group]
    figure = new_figure(15.0, 6.2)
    left, right = figure.subfigures(1, 2, width_ratios=[1.0, 1.9], squeeze=False)[0]
    _draw_image(left.subplots(), looked, groups)
    panels = list(right.subplots(3, 5).flat)
    edges = np.cumsum([len(group) for group in groups])
    for axes, name, values in zip(panels, RELATION_NAMES, _matrices(looked, rows), strict=False):
        _draw_matrix(axes, values, name, edges)
    for axes in panels[len(RELATION_NAMES) :]:
        axes.axis("off")
    panels[len(RELATION_NAMES)].text(0, 1, WORDS, va="top", fontsize=8, color=INK, linespacing=1.4, in_layout=False)
    return figure


def _neighboring_groups(looked: LookedAt) -> list[list[int]]:
    """Hypotheses of the best detection and of those nearest to it, detection by detection."""
    hypotheses = looked.hypotheses
    first = int(looked.score.argmax())
    away = (hypotheses.center - hypotheses.center[first]).norm(dim=1)
    nearest = dict.fromkeys(int(hypotheses.detection[row]) for row in away.argsort())
    return [looked.of_detection(row) for row in list(nearest)[:DETECTIONS]]


def _matrices(looked: LookedAt, rows: list[int]) -> list[NDArray[np.float64]]:
    """The features as (n, n) matrices, NaN for pairs that are no neighbors."""
    index = torch.tensor(rows)
    shown = looked.hypotheses.select(index)
    claims = HypothesisSet(looked.logit[index], shown.rotation, shown.center, looked.angles[index], shown.detection)
    relations: Relations = relation_features(claims, looked.network.model_box)
    matrices = np.full((len(RELATION_NAMES), len(rows), len(rows)), np.nan)
    listener, neighbor = relations.pairs.numpy().T
    matrices[:, listener, neighbor] = relations.features.numpy().T
    return list(matrices)


def _draw_matrix(axes: Axes, values: NDArray[np.float64], name: str, edges: NDArray[np.int64]) -> None:
    largest = max(float(np.nanmax(np.abs(values))), 1e-6)
    low, colors = (-largest, "RdBu_r") if name in SIGNED else (0.0, "viridis")
    image = axes.imshow(values, cmap=colors, vmin=low, vmax=largest)
    axes.set_title(name, fontsize=9, color=INK)
    for edge in edges[:-1]:
        axes.axhline(edge - 0.5, color=INK, linewidth=0.6)
        axes.axvline(edge - 0.5, color=INK, linewidth=0.6)
    middles = edges - np.diff(edges, prepend=0) / 2 - 0.5
    names = [chr(ord("A") + group) for group in range(len(edges))]
    axes.set_xticks(middles, names, fontsize=7, color=INK)
    axes.set_yticks(middles, names, fontsize=7, color=INK)
    axes.tick_params(length=0)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.72, aspect=14)
    bar.ax.tick_params(labelsize=6, labelcolor=INK, length=2)
    bar.outline.set_visible(False)


def _draw_image(axes: Axes, looked: LookedAt, groups: list[list[int]]) -> None:
    axes.imshow(looked.picture(groups))
    corners = []
    for number, group in enumerate(groups):
        x0, y0, x1, y1 = looked.detections.boxes[int(looked.hypotheses.detection[group[0]])].tolist()
        corners += [(x0, y0), (x1, y1)]
        u, v = (x0 + x1) / 2 * SCALE, (y0 + y1) / 2 * SCALE
        style = {"facecolor": "black", "alpha": 0.6, "edgecolor": "none", "pad": 2}
        axes.text(u, v, chr(ord("A") + number), color="white", fontsize=12, ha="center", va="center", bbox=style)
    low, high = np.min(corners, 0) - 12, np.max(corners, 0) + 12
    axes.set_xlim(low[0] * SCALE, high[0] * SCALE)
    axes.set_ylim(high[1] * SCALE, low[1] * SCALE)
    count = sum(len(group) for group in groups)
    title = f"image {looked.view.image_id}: {count} hypotheses of {len(groups)} neighboring detections"
    axes.set_title(title, fontsize=10, color=INK)
    axes.set_xticks([])
    axes.set_yticks([])
