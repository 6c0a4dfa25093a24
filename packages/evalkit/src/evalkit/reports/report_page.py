"""What a report's template shows: its words, figures and tables. Whatever a user named is escaped."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from evalkit.drawing.chart import Chart
from evalkit.drawing.evaluation_picture import LEGEND
from evalkit.drawing.page import counted, render_page
from evalkit.drawing.precision_recall_plot import rule
from evalkit.objects.model import ObjectModel
from evalkit.scoring import published
from evalkit.scoring.bootstrap import LEVEL, Interval
from evalkit.scoring.breakdown import ImageRow
from evalkit.scoring.published import Condition, Table
from evalkit.scoring.result import Result, evalkit_version

ROWS_SHOWN, ROWS_UNFOLDED = 12, 500
JPEG_QUALITY = 88


@dataclass(frozen=True, eq=False)
class Overlay:
    """One drawn image: `picture` (height, width, 3), uint8, BGR."""

    row: ImageRow
    worst: bool
    picture: NDArray[np.uint8]

    def jpeg(self) -> bytes:
        return cv2.imencode(".jpg", self.picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


@dataclass(frozen=True, eq=False)
class Content:
    """What is on the page.

    Attributes:
        result: of all hypotheses; `confident`: of those with at least `score`, where F1 is best.
        intervals: of AP, MAP and best F1 over `scenes`; empty where these are too few.
        rows: the images, worst first.
        inputs: names and hashes of the files.
        folder: name of the folder of figures beside the page.
    """

    object: ObjectModel
    result: Result
    confident: Result
    score: float
    intervals: dict[str, Interval]
    scenes: int
    charts: Sequence[Chart]
    rows: Sequence[ImageRow]
    overlays: Sequence[Overlay]
    inputs: dict[str, dict[str, str]]
    folder: str


def render(content: Content) -> str:
    """The whole page."""
    result = content.result
    table = published.closest_table(result.settings.criterion)
    conditions = published.conditions(table, result)
    return render_page(
        "evalkit.reports",
        "report.html",
        content=content,
        version=evalkit_version(),
        criterion=rule(result.settings.criterion, result.settings.threshold),
        asked=f"instances {result.settings.asked}",
        ap_interval=_ap_interval(content),
        tiles=_tiles(content),
        operating_point=_operating_point(content),
        legend=LEGEND,
        image_head=("image", "AP", "to find", "true", "false", "ignored", "missed", "seconds"),
        images_shown=_image_table(content, content.rows[:ROWS_SHOWN]),
        images_folded=_image_table(content, content.rows[ROWS_SHOWN:ROWS_UNFOLDED]),
        images_left=len(content.rows) - ROWS_UNFOLDED,
        differing=[condition.subject for condition in conditions if condition.holds is False],
        closest=_published_table(table),
        others=[_published_table(other) for other in published.TABLES if other is not table],
        conditions=[_condition_row(condition) for condition in conditions],
        protocol=_protocol(content),
    )


def _tiles(content: Content) -> list[tuple[str, ...]]:
    """Label, value and note of each."""
    result = content.result
    return [
        ("MAP, mean over images", f"{result.map:.3f}", _interval(content, "map")),
        ("best F1", f"{result.best_f1:.3f}", _interval(content, "best_f1")),
        ("recall at precision 0.99", f"{result.recall_at_precision_99:.3f}"),
        ("recall at precision 0.50", f"{result.recall_at_precision_50:.3f}"),
        ("images", f"{result.counts['images']:,}", _images_in_words(content)),
        ("instances to find", f"{result.counts['instances_to_find']:,}", f"of {result.counts['instances']:,}"),
    ]


def _interval(content: Content, key: str) -> str:
    found = content.intervals.get(key)
    return "" if found is None else f"{found.low:.3f} to {found.high:.3f}"


def _ap_interval(content: Content) -> str:
    if not content.intervals:
        return f"no interval: {counted(content.scenes, 'scene')} would be too few for one"
    return f"{100 * LEVEL:g} % interval {_interval(content, 'ap')}, by bootstrap over {content.scenes:,} scenes"


def _images_in_words(content: Content) -> str:
    missing = len(content.result.missing_images)
    return f"of {counted(content.scenes, 'scene')}" + (f"; {missing:,} without predictions" if missing else "")


def _operating_point(content: Content) -> list[tuple[str, str]]:
    counts, curve = content.confident.counts, content.result.curve
    best = int(curve.f1.argmax())
    return [
        ("least score", f"{content.score:.4g}" if np.isfinite(content.score) else "nothing predicted"),
        ("precision, recall", f"{curve.precision[best]:.3f}, {curve.recall[best]:.3f}"),
        ("F1", f"{curve.f1[best]:.3f}"),
        ("true", f"{counts['true']:,}"),
        ("false, of them duplicates", f"{counts['false']:,}, {counts['duplicates']:,}"),
        ("ignored: on instances not asked for", f"{counts['ignored']:,}"),
        ("missed instances", f"{counts['missed']:,} of {counts['instances_to_find']:,}"),
    ]


def _image_table(content: Content, rows: Iterable[ImageRow]) -> list[tuple[str | float, ...]]:
    """The cells of each image; those that are drawn are links to their picture."""
    drawn = {overlay.row.id: number for number, overlay in enumerate(content.overlays, 1)}
    link = Markup('<a href="#overlay-{}">{}</a>')
    return [
        (
            link.format(drawn[row.id], row.id) if row.id in drawn else row.id,
            row.ap,
            *map(str, (row.to_find, row.true, row.false, row.ignored, row.missed)),
            "–" if row.time_s is None else f"{row.time_s:.2f}",
        )
        for row in rows
    ]


def _published_table(table: Table) -> dict[str, Any]:
    return {
        "title": table.title,
        "head": ("method", *table.columns),
        "rows": [
            (method, *(published.figure(table, value) for value in values)) for method, values in table.rows.items()
        ],
        "measure": published.measure_sentence(table),
        "images": table.images,
        "source": table.source,
    }


def _condition_row(condition: Condition) -> tuple[str, ...]:
    style, words = {True: ("yes", "yes"), False: ("no", "no"), None: ("unknown", "not known")}[condition.holds]
    verdict = Markup('<span class="{}">{}</span>').format(style, words)
    return condition.subject, condition.published, condition.here, verdict


def _protocol(content: Content) -> list[tuple[str, str]]:
    result, model = content.result, content.object
    counts = result.counts
    return [
        ("Rules", result.protocol),
        ("Object", f"{model.title}, diameter {1000 * model.diameter:.4g} mm"),
        ("Symmetry", result.symmetry),
        ("Images", f"{counts['images']:,}; without predictions: {counts['images_without_prediction']:,}"),
        (
            "Instances",
            f"{counts['instances']:,}; to find: {counts['instances_to_find']:,}, of them missed by all hypotheses: "
            f"{counts['missed']:,}",
        ),
        (
            "Hypotheses",
            f"{counts['hypotheses']:,}: {counts['true']:,} true, {counts['false']:,} false ({counts['duplicates']:,} "
            f"of them duplicates), {counts['ignored']:,} ignored",
        ),
        *((key.replace("_", " ").capitalize(), _input(entry)) for key, entry in content.inputs.items()),
        ("Versions", f"evalkit {evalkit_version()}, numpy {np.__version__}, Python {platform.python_version()}"),
    ]


def _input(entry: dict[str, str]) -> str:
    return Markup("{}<br><code>sha256 {}</code>").format(entry["file"], entry["sha256"])
