"""The curves of a run: losses and validation AP over the images seen, with the minutes along the top."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evalkit.atomic import atomic_path

Rows = Sequence[dict[str, float]]
POSITION = ("step", "images", "minutes", "progress")


def draw_progress(path: Path | str, history: Rows, validations: Rows, title: str) -> None:
    """Write the picture (PNG) atomically.

    Args:
        history: rows with "images", "minutes" and losses by name. validations: rows with "images", "minutes" and "ap".
    """
    figure = Figure(figsize=(9, 7), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    figure.suptitle(title)
    _draw_losses(above, history)
    _draw_ap(below, validations)
    below.set_xlim(left=0)
    _mark_minutes(above, [*history, *validations])
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)


def _draw_losses(axes: Axes, history: Rows) -> None:
    names = sorted({name for row in history for name in row} - set(POSITION), key=lambda name: (name != "total", name))
    for name in names:
        points = [(row["images"], row[name]) for row in history if row.get(name, 0.0) > 0.0]
        style = {"color": "black", "linewidth": 2.0} if name == "total" else {"linewidth": 1.0}
        axes.plot(*np.array(points).reshape(-1, 2).T, marker=".", markersize=3, label=name, **style)
    axes.set(yscale="log", ylabel="loss (total weighted, parts not)")
    axes.grid(alpha=0.3)
    if names:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")


def _draw_ap(axes: Axes, validations: Rows) -> None:
    points = np.array([(row["images"], row["ap"]) for row in validations]).reshape(-1, 2)
    axes.plot(*points.T, marker="o", color="tab:green")
    for images, ap in points:
        axes.annotate(f"{ap:.3f}", (images, ap), textcoords="offset points", xytext=(0, 5), ha="center", fontsize=8)
    axes.set(ylim=(-0.02, 1.12), xlabel="images", ylabel="validation AP")
    axes.grid(alpha=0.3)


def _mark_minutes(axes: Axes, rows: Rows) -> None:
    points = sorted({(row["images"], row["minutes"]) for row in rows} | {(0.0, 0.0)})
    if len(points) < 2:
        return
    images, minutes = np.array(points).T
    ticks = np.linspace(0, len(points) - 1, 6).round().astype(int)
    top = axes.secondary_xaxis("top")
    top.set_xticks(images[ticks], [f"{minute:.3g}" for minute in minutes[ticks]])
    top.set_xlabel("minutes")
