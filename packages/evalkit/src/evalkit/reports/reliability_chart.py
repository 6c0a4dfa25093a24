"""The reliability diagram: how often poses of a score are right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from evalkit.drawing.chart import Chart
from evalkit.drawing.plots import INK, LINE, tidy
from evalkit.scoring.calibration import calibration
from evalkit.scoring.matching import IGNORED, TRUE
from evalkit.scoring.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def reliability(result: Result) -> Chart:
    """Poses that are ignored count as right here: they lie on an instance, which nobody asked for."""
    right = np.isin(result.matching.outcome, (TRUE, IGNORED))
    found = calibration(result.crowd.score, right)
    known = np.zeros(0, np.int64) if found is None else np.flatnonzero(found.count)

    def draw(axes: Axes) -> None:
        axes.plot([0, 1], [0, 1], color=INK, linestyle="--", linewidth=1.0)
        if found is None or not len(known):
            words = "scores are no probabilities" if found is None else "no hypotheses"
            axes.text(0.5, 0.3, words, ha="center", va="center", color=INK)
        else:
            middle = (found.edges[known] + found.edges[known + 1]) / 2
            axes.bar(middle, found.right[known], width=0.092, color=LINE, alpha=0.25)
            axes.plot(found.score[known], found.right[known], "o", color=LINE, markersize=5)
            for x, count in zip(middle, found.count[known], strict=True):
                axes.text(x, 1.03, str(count), ha="center", fontsize=8, color=INK)
        axes.set(xlim=(0, 1), ylim=(0, 1.1), xlabel="score", ylabel="share that is right")
        axes.set(xticks=np.linspace(0, 1, 6), yticks=np.linspace(0, 1, 6))
        tidy(axes)

    return Chart(
        name="reliability",
        title="What scores are worth",
        caption=_caption(None if found is None else found.error),
        columns=("low", "high", "hypotheses", "mean_score", "right"),
        rows=[(found.edges[k], found.edges[k + 1], int(found.count[k]), found.score[k], found.right[k]) for k in known]
        if found is not None
        else [],
        draw=draw,
    )


def _caption(error: float | None) -> str:
    if error is None:
        return "Some scores lie beyond 0 and 1, so they rank poses but say nothing of how many are right."
    mean = "" if np.isnan(error) else f" Over all hypotheses they miss it by {error:.3f} on average."
    return (
        "On the dashed line a score is the share that is right: of poses scored 0.9, nine in ten. Numbers on top are "
        f"hypotheses; ignored ones count as right, duplicates as wrong.{mean}"
    )
