"""The precision-recall curve, drawn, with its figures and rules."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from evalkit.drawing.plots import FILL, INK, LINE, new_figure, save, tidy
from evalkit.scoring.distances import CRITERIA
from evalkit.scoring.result import Result
from evalkit.scoring.rules import Settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_precision_recall(axes: Axes, result: Result) -> None:
    """The curve as the steps that its area is measured under, with AP and the point of the best F1."""
    curve = result.curve
    recall, precision = np.r_[0.0, curve.recall], np.r_[curve.precision[:1], curve.precision]
    axes.step(recall, precision, where="pre", color=LINE, linewidth=1.8)
    axes.fill_between(recall, precision, step="pre", color=FILL, linewidth=0)
    best = int(curve.f1.argmax())
    axes.plot(curve.recall[best], curve.precision[best], "o", color=LINE, markersize=6, markeredgecolor="white")
    low = result.ap < 0.5  # the curve then leaves the upper right corner free, and else the lower left one
    x, y, side, end = (0.97, 0.95, "right", "top") if low else (0.03, 0.05, "left", "bottom")
    axes.text(x, y, _figures(result), transform=axes.transAxes, color=INK, linespacing=1.4, ha=side, va=end)
    axes.set(xlim=(0, 1.01), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
    axes.set_title(title(result), loc="left", color=INK)
    tidy(axes)


def title(result: Result) -> str:
    """One line: the figure and the rules it follows."""
    settings = result.settings
    return (
        f"AP {result.ap:.3f}   {rule(settings.criterion, settings.threshold)}, "
        f"{visibility_rule(settings)}, {settings.protocol}"
    )


def visibility_rule(settings: Settings) -> str:
    """Such as "geometric visibility ≥ 0.5"."""
    share = f"{settings.visibility} " if settings.visibility else ""
    return f"{share}visibility ≥ {settings.min_visibility:g}"


def rule(criterion: str, threshold: float) -> str:
    """Such as "Sym ≤ 0.1 d": d are diameters."""
    return f"{CRITERIA[criterion].title} ≤ {threshold:g} {'px' if CRITERIA[criterion].in_pixels else 'd'}"


def _figures(result: Result) -> str:
    return (
        f"MAP {result.map:.3f}\nbest F1 {result.best_f1:.3f} (dot)\n"
        f"recall at precision 0.99: {result.recall_at_precision_99:.3f}"
    )


def save_precision_recall(result: Result, path: Path | str) -> None:
    """Write the curve as PNG, or as what the suffix says."""
    figure = new_figure(6.4, 5.0)
    draw_precision_recall(figure.add_subplot(), result)
    save(figure, path)
