"""The figures of a report: what each shows in words, how it is drawn, and the table of numbers behind it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.visibility_share import in_words
from evalkit.drawing.chart import Chart, binned_rows
from evalkit.drawing.plots import GRAY, INK, LINE, legend_below, tidy
from evalkit.drawing.precision_recall_plot import draw_precision_recall, rule
from evalkit.scoring.breakdown import CriterionAp, PoseErrors, VisibilityAp
from evalkit.scoring.distances import CRITERIA
from evalkit.scoring.matching import DUPLICATE, FALSE, IGNORED, TRUE
from evalkit.scoring.result import Result
from evalkit.scoring.rules import Settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
GREEN, RED, PALE = "#2f9e44", "#d9413b", "#b9cfe8"
SCORE_BINS, ERROR_BINS = 40, 40
SMALLEST_ERROR = 1e-3  # degrees or millimeters; no camera tells less
LARGEST_SCORE, LEAST_SCORE_SPAN = 1e15, 1e-9  # beyond and below which no axis can be drawn


def precision_recall(result: Result) -> Chart:
    curve = result.curve
    columns = (curve.score, curve.precision, curve.recall, curve.f1)
    return Chart(
        name="precision_recall",
        title="Precision and recall",
        caption="As the least score is lowered, more is found and more of it is false. "
        + (
            "AP is the mean of the best precision at 101 recalls or beyond."
            if result.settings.protocol == "coco"
            else "The area under the steps is AP."
        )
        + " The dot is the best F1.",
        columns=("score", "precision", "recall", "f1"),
        rows=list(zip(*(column.tolist() for column in columns), strict=True)),
        draw=lambda axes: draw_precision_recall(axes, result),
    )


def score_histogram(result: Result, score: float) -> Chart:
    """`score`: from which on hypotheses are acted on."""
    kinds = {"true": (TRUE,), "ignored": (IGNORED,), "false": (FALSE, DUPLICATE)}
    shown, outcome = np.clip(result.crowd.score, -LARGEST_SCORE, LARGEST_SCORE), result.matching.outcome
    edges = _score_edges(shown)
    counts = {name: np.histogram(shown[np.isin(outcome, kind)], edges)[0] for name, kind in kinds.items()}

    def draw(axes: Axes) -> None:
        for (name, count), color in zip(counts.items(), (GREEN, GRAY, RED), strict=True):
            if count.any():
                axes.stairs(count, edges, fill=True, color=color, alpha=0.25)
                axes.stairs(count, edges, color=color, linewidth=1.6, label=f"{name} ({count.sum()})")
        _log_counts(axes, max(int(count.max()) for count in counts.values()), "no hypotheses")
        if edges[0] <= score <= edges[-1]:
            axes.axvline(score, color=INK, linestyle="--", linewidth=1.2)
        axes.set(xlabel="score", ylabel="hypotheses")

    return Chart(
        name="scores",
        title="Scores of true and false hypotheses",
        caption="The less green and red overlap, the more the score can be trusted. Dashed: the best F1. "
        "Counts are on a logarithmic scale.",
        columns=("low", "high", *counts),
        rows=binned_rows(edges, *counts.values()),
        draw=draw,
    )


def ap_by_threshold(ladder: list[tuple[float, float]], result: Result) -> Chart:
    settings = result.settings
    thresholds, aps = np.array(ladder).T
    unit = "px of an image 640 px wide" if CRITERIA[settings.criterion].in_pixels else "object diameters"
    title = CRITERIA[settings.criterion].title

    def draw(axes: Axes) -> None:
        axes.plot(thresholds, aps, color=LINE, linewidth=1.8, marker="o", markersize=3.5)
        axes.plot(settings.threshold, result.ap, "o", color=LINE, markersize=9, markeredgecolor="white")
        axes.set(xscale="log", ylim=(-0.02, 1.04), xlabel=f"{title} threshold, {unit}", ylabel="AP")
        _plain_ticks(axes, thresholds)
        tidy(axes)

    return Chart(
        name="ap_by_threshold",
        title="AP by threshold",
        caption="How close a pose must be to count as true. The large dot is this evaluation's own threshold.",
        columns=("threshold", "ap"),
        rows=ladder,
        draw=draw,
    )


def ap_by_criterion(found: list[CriterionAp]) -> Chart:
    def draw(axes: Axes) -> None:
        axes.barh([rule(e.criterion, e.threshold) for e in found], [e.ap or 0.0 for e in found], color=LINE, height=0.6)
        for row, entry in enumerate(found):
            words = "not computed" if entry.ap is None else f"{entry.ap:.3f}"
            axes.text((entry.ap or 0.0) + 0.01, row, words, va="center", color=INK)
        axes.set(xlim=(0, 1.12), xticks=np.linspace(0, 1, 6), xlabel="AP")
        axes.invert_yaxis()
        tidy(axes)
        axes.grid(axis="y", visible=False)

    reasons = dict.fromkeys(entry.reason for entry in found if entry.ap is None)
    return Chart(
        name="ap_by_criterion",
        title="AP by criterion",
        caption="The same poses by other distances, each at its own threshold (d: diameters, px: pixels of an image "
        "640 px wide). AP of one criterion says nothing against AP of another."
        + "".join(f" Not computed: {reason}" for reason in reasons),
        columns=("criterion", "threshold", "ap"),
        rows=[(entry.criterion, entry.threshold, entry.ap) for entry in found],
        draw=draw,
    )


def ap_by_visibility(bins: list[VisibilityAp], settings: Settings) -> Chart:
    known = [entry for entry in bins if entry.instances]
    asked = [entry for entry in known if entry.low >= settings.min_visibility - 1e-9]
    others = [entry for entry in known if entry.low < settings.min_visibility - 1e-9]

    def draw(axes: Axes) -> None:
        for entries, color, label in ((asked, LINE, "AP"), (others, PALE, "AP, too hidden to be asked for")):
            if entries:
                axes.bar([_middle(e) for e in entries], [e.ap for e in entries], width=8.4, color=color, label=label)
        if known:
            shares = [entry.recall for entry in known]
            axes.plot([_middle(e) for e in known], shares, "D", color=INK, markersize=5, label="share found")
        for entry in known:
            axes.text(_middle(entry), 1.04, str(entry.instances), ha="center", fontsize=8, color=INK)
        axes.set(xlim=(0, 100), ylim=(0, 1.12), xticks=range(0, 101, 10), yticks=np.linspace(0, 1, 6))
        axes.set(xlabel=f"visible, % of the silhouette ({in_words(settings.visibility)})", ylabel="AP, share found")
        tidy(axes)
        _legend(axes, "no instances")

    return Chart(
        name="ap_by_visibility",
        title="AP by visibility",
        caption="Only the instances of a bin (numbers on top) are asked for, in the images that show one; a hypothesis "
        "on any other is ignored, but a false one counts in every bin. Diamonds: share found, whatever the score.",
        columns=("low", "high", "instances", "ap", "found"),
        rows=[(entry.low, entry.high, entry.instances, entry.ap, entry.recall) for entry in bins],
        draw=draw,
    )


def _middle(entry: VisibilityAp) -> float:
    return 50.0 * (entry.low + entry.high)


def rotation_errors(errors: PoseErrors) -> Chart:
    return _error_histogram("rotation", "degrees", np.degrees(errors.rotation), 180.0, errors)


def translation_errors(errors: PoseErrors, diameter: float) -> Chart:
    return _error_histogram("translation", "mm", 1000.0 * errors.translation, 500.0 * diameter, errors)


def _error_histogram(kind: str, unit: str, error: Array, most: float, errors: PoseErrors) -> Chart:
    edges = np.geomspace(_decade_below(error, most), most, ERROR_BINS + 1, dtype=np.float64)
    shown = np.clip(error, edges[0], edges[-1])
    counts = {
        "true": np.histogram(shown[errors.right], edges)[0],
        "too far off": np.histogram(shown[~errors.right], edges)[0],
    }

    def draw(axes: Axes) -> None:
        below = np.zeros(ERROR_BINS)
        for (name, count), color in zip(counts.items(), (GREEN, RED), strict=True):
            if count.any():
                axes.stairs(
                    below + count, edges, baseline=below, fill=True, color=color, label=f"{name} ({count.sum()})"
                )
            below = below + count
        axes.set(xscale="log", xlim=(edges[0], edges[-1]), xlabel=f"{kind} error, {unit}", ylabel="instances")
        _plain_ticks(axes, edges)
        tidy(axes)
        _legend(axes, "no hypothesis is near an instance")

    return Chart(
        name=f"{kind}_errors",
        title=f"{kind.capitalize()} error",
        caption=_spread_in_words(error[errors.right], unit) + " At the score of the best F1 or above, a "
        f"hypothesis lies within half a diameter of {len(error)} of the instances to find ({errors.instances}).",
        columns=("low", "high", *(name.replace(" ", "_") for name in counts)),
        rows=binned_rows(edges, *counts.values()),
        draw=draw,
    )


def _spread_in_words(error: Array, unit: str) -> str:
    if not len(error):
        return "No pose is true."
    half, most = np.quantile(error, [0.5, 0.9])
    sign = "°" if unit == "degrees" else f" {unit}"
    return f"True poses: half are within {half:.2g}{sign}, 90 % within {most:.2g}{sign}."


def _decade_below(error: Array, most: float) -> float:
    """The power of ten below almost all errors."""
    small = np.quantile(error, 0.02) if len(error) else 0.1
    return float(10.0 ** np.floor(np.log10(np.clip(small, SMALLEST_ERROR, most / 10))))


def _score_edges(score: Array) -> Array:
    low, high = (float(score.min()), float(score.max())) if len(score) else (0.0, 1.0)
    size = max(abs(low), abs(high), LEAST_SCORE_SPAN)
    if high - low < LEAST_SCORE_SPAN * size:
        low, high = low - size / 2, high + size / 2
    return np.linspace(low, high, SCORE_BINS + 1, dtype=np.float64)


def _log_counts(axes: Axes, most: int, otherwise: str) -> None:
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(0, 2.0 * max(most, 5))
    ticks = [10**power for power in range(int(np.log10(max(most, 5))) + 1)]
    axes.set_yticks([0, *ticks], ["0", *map(str, ticks)])
    tidy(axes)
    _legend(axes, otherwise)


def _legend(axes: Axes, otherwise: str) -> None:
    """The legend, or words where nothing was drawn."""
    if axes.get_legend_handles_labels()[1]:
        legend_below(axes)
    else:
        axes.text(0.5, 0.5, otherwise, transform=axes.transAxes, ha="center", va="center", color=INK)


def _decades(least: float, most: float) -> Array:
    """1, 2 and 5 times the powers of ten from least to most."""
    steps = np.multiply.outer(10.0 ** np.arange(-3, 7), [1.0, 2.0, 5.0]).ravel()
    return np.asarray(steps[(steps >= least * 0.999) & (steps <= most * 1.001)])


def _plain_ticks(axes: Axes, values: Array) -> None:
    """Numbers as people write them, at 1, 2 and 5, on a logarithmic axis."""
    ticks = _decades(values.min(), values.max())
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
