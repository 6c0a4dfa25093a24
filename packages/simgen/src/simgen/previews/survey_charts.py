"""The histograms of a survey, as charts of a page."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from evalkit.drawing.chart import Chart, binned_rows
from evalkit.drawing.plots import GRAY, INK, LINE, legend_below, tidy
from simgen.previews.survey import CLEAR, Survey

VISIBILITY_BINS, ANGLE_BINS = 20, 18
AROUND, UPWARD = 24, 12  # cells of the map of directions, all of the same solid angle


def survey_charts(found: Survey, symmetry: str) -> list[Chart]:
    """Five charts; `symmetry` is the object's, by name."""
    return [visibility(found), instances(found), depth(found), tilt(found, symmetry), directions(found, symmetry)]


def visibility(found: Survey) -> Chart:
    edges = np.linspace(0, 1, VISIBILITY_BINS + 1)
    counts, _ = np.histogram(np.clip(found.visibility, 0, 1), edges)
    hidden, clear = (_share(rows) for rows in (found.visibility == 0, found.visibility >= CLEAR))

    def draw(axes: Axes) -> None:
        axes.stairs(counts, edges, fill=True, color=LINE)
        axes.axvline(CLEAR, color=INK, linestyle="--", linewidth=1.2)
        axes.set(xlim=(0, 1), xlabel="visible part of the silhouette (geometric share)", ylabel="instances in frames")
        tidy(axes)

    return Chart(
        name="visibility",
        title="Visibility",
        caption=f"{clear:.0%} are at least half visible (right of the dashed line), {hidden:.0%} are hidden whole. "
        "What the sensor lost counts as visible.",
        columns=("low", "high", "instances"),
        rows=binned_rows(edges, counts),
        draw=draw,
    )


def instances(found: Survey) -> Chart:
    edges = np.arange(max(found.instances.max(initial=0), found.clear.max(initial=0)) + 2) - 0.5
    fallen, clear = (np.histogram(counts, edges)[0] for counts in (found.instances, found.clear))

    def draw(axes: Axes) -> None:
        for counts, color, label in ((fallen, GRAY, "in the scene"), (clear, LINE, "at least half visible, a frame")):
            shares = counts / max(int(counts.sum()), 1)
            axes.stairs(shares, edges, fill=True, color=color, alpha=0.3)
            axes.stairs(shares, edges, color=color, linewidth=1.6, label=label)
        axes.set(xlabel="instances", ylabel="share of scenes, of frames")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        tidy(axes)
        legend_below(axes)

    return Chart(
        name="instances",
        title="Number of instances",
        caption=f"{found.instances.mean():.1f} a scene on average, of which {found.clear.mean():.1f} are at least half "
        "visible from one camera.",
        columns=("low", "high", "scenes", "frames"),
        rows=binned_rows(edges, fallen, clear),
        draw=draw,
    )


def depth(found: Survey) -> Chart:
    edges = 1e3 * found.depth_edges

    def draw(axes: Axes) -> None:
        for counts, color, label in (
            (found.elsewhere, GRAY, "bin and ground"),
            (found.on_instances, LINE, "instances"),
        ):
            axes.stairs(counts, edges, fill=True, color=color, alpha=0.3)
            axes.stairs(counts, edges, color=color, linewidth=1.6, label=label)
        axes.set(xlabel="depth, mm", ylabel="pixels")
        tidy(axes)
        legend_below(axes)

    return Chart(
        name="depth",
        title="Depth",
        caption=f"Pixels of {found.frames_read:,} frames; the farthest 0.5 % are beyond the right end. "
        f"{found.no_return:.2%} of all pixels have no return.",
        columns=("low_mm", "high_mm", "on_instances", "elsewhere"),
        rows=binned_rows(edges, found.on_instances, found.elsewhere),
        draw=draw,
    )


def tilt(found: Survey, symmetry: str) -> Chart:
    edges = np.linspace(0, 180, ANGLE_BINS + 1)
    counts, _ = np.histogram(np.degrees(found.axis_from_up), edges)
    even = -np.diff(np.cos(np.radians(edges))) / 2 * counts.sum()
    axis = "z axis" if symmetry in ("none", "sphere") else "symmetry axis"

    def draw(axes: Axes) -> None:
        axes.stairs(counts, edges, fill=True, color=LINE)
        axes.plot((edges[1:] + edges[:-1]) / 2, even, color=INK, linestyle="--", linewidth=1.2, label="even")
        axes.set(xlim=(0, 180), xticks=range(0, 181, 30), ylabel="instances")
        axes.set(xlabel=f"angle between the object's {axis} and the vertical, degrees")
        tidy(axes)
        legend_below(axes)

    return Chart(
        name="tilt",
        title="How instances lie",
        caption="0° is upright, 90° lying, 180° upside down. Dashed: if every orientation were as frequent; what is "
        "above it is how the object likes to rest.",
        columns=("low", "high", "instances", "even"),
        rows=[(*row, value) for row, value in zip(binned_rows(edges, counts), even.tolist(), strict=True)],
        draw=draw,
    )


def directions(found: Survey, symmetry: str) -> Chart:
    around, height = np.linspace(-180, 180, AROUND + 1), np.linspace(-1, 1, UPWARD + 1)
    x, y, z = found.directions.T
    counts, _, _ = np.histogram2d(np.degrees(np.arctan2(y, x)), z, (around, height))
    relative = counts / max(counts.mean(), 1e-9)
    never = _share(counts == 0)

    def draw(axes: Axes) -> None:
        most = max(2.0, relative.max())
        shown = axes.pcolormesh(around, height, relative.T, vmin=0, vmax=most, edgecolors="face", linewidth=0.2)
        axes.figure.colorbar(shown, ax=axes, label="times the average")
        ticks = [-90, -45, -20, 0, 20, 45, 90]
        axes.set_yticks(np.sin(np.radians(ticks)), [str(tick) for tick in ticks])
        axes.set(xticks=range(-180, 181, 60), xlabel="around the object's z, degrees", ylabel="above its xy plane")

    return Chart(
        name="directions",
        title="From where instances are seen",
        caption="Where the camera stands in the object's own frame, over all visible instances. Every cell is as large "
        f"on the sphere as any other; {never:.0%} are empty."
        + ("" if symmetry == "none" else f" Under the symmetry ({symmetry}) several directions look the same."),
        columns=("around_low", "around_high", "sin_low", "sin_high", "instances"),
        rows=[
            (*around[i : i + 2].tolist(), *height[j : j + 2].tolist(), int(counts[i, j]))
            for i, j in product(range(AROUND), range(UPWARD))
        ],
        draw=draw,
    )


def _share(which: NDArray[np.bool_]) -> float:
    return float(which.mean()) if which.size else 0.0
