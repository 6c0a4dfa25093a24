"""One detection: its crop with the hypotheses' contours, beside what the network thinks of every bin."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evalkit.drawing.plots import INK, new_figure
from posenet.coding.class_bins import Bins
from posenet.figures.looked_at import COLORS, SCALE, LookedAt

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEGREES = 180 / np.pi
MARGIN = 0.35  # of the box's side, around the crop
HEAT = "magma"


def draw_hypotheses(looked: LookedAt) -> Figure:
    """The detection whose hypotheses are most in number and surest, with its marginals a, b, c and depth."""
    row = _telling_detection(looked)
    rows = looked.of_detection(row)
    figure = new_figure(13.0, 6.6)
    left, right = figure.subfigures(1, 2, width_ratios=[1.0, 1.5], squeeze=False)[0]
    _draw_crop(left.subplots(), looked, row, rows)
    strips = right.subplots(4, 1)
    a, b, c = looked.network.codec.angle_bins
    angles = looked.angles[rows].double().numpy()
    marginals = [logits[row].softmax(-1).double().numpy() for logits in looked.outputs.angles]
    names = ("in-plane a (degrees)", "tilt b (degrees)", "spin c (degrees)")
    for k, (axes, bins, marginal, name) in enumerate(zip(strips, (a, b, c), marginals, names, strict=False)):
        _draw_marginal(axes, bins, marginal, angles[:, k], name, DEGREES)
    depth = looked.outputs.depth[row].softmax(-1).double().numpy()
    bins = looked.network.codec.depth_bins
    relative = looked.network.config.network.depth == "relative"
    name = "depth of the center " + ("behind the region's median (mm)" if relative else "(mm)")
    _draw_marginal(strips[3], bins, depth, looked.hypotheses.depth[rows].double().numpy(), name, 1e3)
    right.suptitle("probability of each bin (brighter: likelier); marks: the hypotheses", fontsize=10, color=INK)
    return figure


def _telling_detection(looked: LookedAt) -> int:
    """Of the detections with the most hypotheses, the one with the best score."""
    rows = range(len(looked.detections.scores))
    return max(rows, key=lambda row: (len(looked.of_detection(row)), looked.score[looked.of_detection(row)].max()))


def _draw_crop(axes: Axes, looked: LookedAt, row: int, rows: list[int]) -> None:
    x0, y0, x1, y1 = looked.detections.boxes[row].tolist()
    side = max(x1 - x0, y1 - y0) * (0.5 + MARGIN)
    u, v = (x0 + x1) / 2, (y0 + y1) / 2
    axes.imshow(looked.picture([rows]))
    axes.set_xlim((u - side) * SCALE, (u + side) * SCALE)
    axes.set_ylim((v + side) * SCALE, (v - side) * SCALE)
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]) * SCALE
    axes.plot(*corners.T, color="white", linewidth=1, linestyle=":")
    for number, hypothesis in enumerate(rows):
        color = [channel / 255 for channel in COLORS[number]]
        words = (
            f"{number + 1}:  confidence {looked.logit[hypothesis].sigmoid():.2f}, score {looked.score[hypothesis]:.2f}"
        )
        axes.plot([], [], color=color, linewidth=3, label=words)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), frameon=False, fontsize=9, labelcolor=INK)
    axes.set_title(
        f"image {looked.view.image_id}: {len(rows)} hypotheses of one detection\n(dotted: its box, "
        f"score {looked.detections.scores[row]:.2f})", fontsize=10, color=INK,
    )  # fmt: skip
    axes.set_xticks([])
    axes.set_yticks([])


def _draw_marginal(
    axes: Axes, bins: Bins, marginal: NDArray[np.float64], values: NDArray[np.float64], name: str, unit: float
) -> None:
    low, high = bins.low * unit, bins.high * unit
    # A square root, so that what is unlikely but possible can be seen.
    axes.imshow(np.sqrt(marginal)[None], aspect="auto", cmap=HEAT, vmin=0, extent=(low, high, 0, 1))
    axes.set_xlim(low, high)
    axes.set_ylim(0, 1.75)
    axes.set_yticks([])
    axes.set_xlabel(f"{name}, {bins.count} bins", fontsize=9, color=INK)
    period = bins.high - bins.low
    for number, value in enumerate(values):
        position = (bins.low + (value - bins.low) % period if bins.circular else value) * unit
        color = [channel / 255 for channel in COLORS[number]]
        height = 1.12 + 0.13 * number
        axes.plot([position, position], [1.0, height], color=color, linewidth=2)
        axes.plot(position, height, marker="o", markersize=5, color=color)
    for spine in ("top", "right", "left"):
        axes.spines[spine].set_visible(False)
