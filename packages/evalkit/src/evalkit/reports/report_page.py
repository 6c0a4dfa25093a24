"""The HTML of a report. Whatever a user named is escaped."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.drawing.chart import Chart
from evalkit.drawing.page import chart_figure, counted, data_uri, decimals, facts, html_table, page, tile
from evalkit.drawing.picture import LEGEND
from evalkit.drawing.plots import rule
from evalkit.objects.model import ObjectModel
from evalkit.scoring import published
from evalkit.scoring.bootstrap import LEVEL, Interval
from evalkit.scoring.breakdown import ImageRow
from evalkit.scoring.evaluation import Result, evalkit_version
from evalkit.scoring.published import Condition, Table

ROWS_SHOWN, ROWS_UNFOLDED = 12, 500
JPEG_QUALITY = 88


@dataclass(frozen=True, eq=False)
class Overlay:
    """One drawn image: `picture` (height, width, 3), uint8, BGR."""

    row: ImageRow
    worst: bool
    picture: NDArray[np.uint8]


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
    sections = (_header, _figures, _images, _published, _protocol)
    title = f"{content.result.object_title}: AP {content.result.ap:.3f}"
    return page(title, "\n".join(section(content) for section in sections))


def _header(content: Content) -> str:
    result = content.result
    tiles = [
        tile("MAP, mean over images", f"{result.map:.3f}", _interval(content, "map")),
        tile("best F1", f"{result.best_f1:.3f}", _interval(content, "best_f1")),
        tile("recall at precision 0.99", f"{result.recall_at_precision_99:.3f}"),
        tile("recall at precision 0.50", f"{result.recall_at_precision_50:.3f}"),
        tile("images", f"{result.counts['images']:,}", _images_in_words(content)),
        tile("instances to find", f"{result.counts['instances_to_find']:,}", f"of {result.counts['instances']:,}"),
    ]
    criterion = escape(rule(result.settings.criterion, result.settings.threshold))
    asked = f"instances at least {100 * result.settings.min_visibility:g} % visible"
    return f"""<header>
<p class="kicker">How good are these 6D poses? A report by evalkit {escape(evalkit_version())}</p>
<h1>{escape(result.object_title)}</h1>
<p class="lead"><strong>AP {result.ap:.3f}</strong>
<span>{criterion}, {asked}, protocol {result.settings.protocol}<br>{_ap_interval(content)}</span></p>
<nav><a href="#figures">Figures</a> <a href="#images">Images</a> <a href="#published">Published results</a>
<a href="#protocol">Protocol, counts, hashes</a></nav>
<dl class="tiles">{"".join(tiles)}</dl>
</header>"""


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


def _figures(content: Content) -> str:
    cells = [chart_figure(chart) for chart in content.charts]
    return f"""<section id="figures">
<h2>Figures</h2>
<p class="soft">Each lies as PNG, and its numbers as CSV, in <code>{escape(content.folder)}/</code> beside this
page.</p>
<div class="grid">{"".join([*cells, _operating_point(content)])}</div>
</section>"""


def _operating_point(content: Content) -> str:
    counts, curve = content.confident.counts, content.result.curve
    best = int(curve.f1.argmax())
    rows = [
        ("least score", f"{content.score:.4g}" if np.isfinite(content.score) else "nothing predicted"),
        ("precision, recall", f"{curve.precision[best]:.3f}, {curve.recall[best]:.3f}"),
        ("F1", f"{curve.f1[best]:.3f}"),
        ("true", f"{counts['true']:,}"),
        ("false, of them duplicates", f"{counts['false']:,}, {counts['duplicates']:,}"),
        ("ignored: on instances not asked for", f"{counts['ignored']:,}"),
        ("missed instances", f"{counts['missed']:,} of {counts['instances_to_find']:,}"),
    ]
    return f"""<figure id="operating_point"><h3>At the best F1</h3>
{html_table((), [(escape(words), value) for words, value in rows], "wide")}
<figcaption>What a robot would act on. The pose errors, the pictures and the counts of each image are of these
hypotheses; AP is of all.</figcaption></figure>
"""


def _images(content: Content) -> str:
    shown, more = content.rows[:ROWS_SHOWN], content.rows[ROWS_SHOWN:ROWS_UNFOLDED]
    rest = len(content.rows) - ROWS_UNFOLDED
    folded = f"<details><summary>{len(more):,} more images</summary>{_image_table(content, more)}</details>"
    note = f"<p class='soft'>{rest:,} better ones are left to images.csv.</p>" if rest > 0 else ""
    return f"""<section id="images">
<h2>Images</h2>
{_overlays(content)}
<h3 style="margin-top: 2.2rem">Worst first</h3>
<p class="soft">AP is of all the image's hypotheses; the counts are of those at the best F1. All are in
<code>{escape(content.folder)}/images.csv</code>.</p>
{_image_table(content, shown)}
{folded if more else ""}{note}
</section>"""


def _overlays(content: Content) -> str:
    if not content.overlays:
        return "<p class='soft'>No pictures: the folder of depth images was not given (<code>--shards</code>).</p>"
    swatches = "".join(
        f"<li><i style='--swatch: rgb({red}, {green}, {blue})'></i>{escape(words)}</li>"
        for words, (blue, green, red) in LEGEND
    )
    figures = "".join(_overlay(number, overlay) for number, overlay in enumerate(content.overlays, 1))
    return f"""<p class="soft">Outlines of poses over the depth: the images with the least AP, then others from all over
the set.</p>
<ul class="legend">{swatches}</ul>
<div class="overlays">{figures}</div>"""


def _overlay(number: int, overlay: Overlay) -> str:
    row, worst = overlay.row, ", among the worst" if overlay.worst else ""
    jpeg = cv2.imencode(".jpg", overlay.picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return f"""<figure id="overlay-{number}">
<img alt="Poses on image {escape(row.id)}" src="{data_uri("image/jpeg", jpeg)}">
<figcaption><b>{escape(row.id)}</b>{worst}: AP {decimals(row.ap)};
{row.true} true, {row.false} false, {row.ignored} ignored, {row.missed} missed</figcaption></figure>
"""


def _image_table(content: Content, rows: Iterable[ImageRow]) -> str:
    drawn = {overlay.row.id: number for number, overlay in enumerate(content.overlays, 1)}
    head = ("image", "AP", "to find", "true", "false", "ignored", "missed", "seconds")
    body: list[Sequence[str | float]] = [
        (
            f"<a href='#overlay-{drawn[row.id]}'>{escape(row.id)}</a>" if row.id in drawn else escape(row.id),
            row.ap,
            *map(str, (row.to_find, row.true, row.false, row.ignored, row.missed)),
            "–" if row.time_s is None else f"{row.time_s:.2f}",
        )
        for row in rows
    ]
    return html_table(head, body, "wide")


def _published(content: Content) -> str:
    result = content.result
    table = published.closest_table(result.settings.criterion)
    conditions = published.conditions(table, result)
    others = "".join(_published_table(other) for other in published.TABLES if other is not table)
    criterion = rule(result.settings.criterion, result.settings.threshold)
    return f"""<section id="published">
<h2>Published results, beside this run</h2>
<p class="warning">{_verdict(conditions)}</p>
<div class="grid">
{_published_table(table)}
<div class="run"><h3>This run: {escape(result.object_title)}</h3>
<strong>AP {result.ap:.3f}</strong>
{escape(criterion)}, {counted(result.counts["images"], "image")},
{counted(result.counts["instances_to_find"], "instance")} to find; {_ap_interval(content)}.</div>
</div>
<h3 style="margin-top: 1.8rem">What must be the same, and whether it is</h3>
{_condition_table(conditions)}
<details><summary>Other published tables</summary><div class="grid">{others}</div></details>
</section>"""


def _verdict(conditions: Sequence[Condition]) -> str:
    differing = [condition.subject for condition in conditions if condition.holds is False]
    if differing:
        return (
            f"<b>Not comparable.</b> These figures and this run's differ in: {', '.join(differing)}. They stand side "
            "by side to show what has been reached elsewhere; do not rank one against the other."
        )
    return (
        "<b>Comparable only if what is not known below is the same too,</b> above all the images: the published "
        "figures are of all the test images of their data sets. This page cannot tell whether yours are those."
    )


def _published_table(table: Table) -> str:
    rows = [
        (escape(method), *(published.figure(table, value) for value in values)) for method, values in table.rows.items()
    ]
    return f"""<div><h3>{escape(table.title)}</h3>
{html_table(("method", *table.columns), rows, "wide")}
<p class="source">{escape(published.measure_sentence(table))} On {escape(table.images)}.
Source: {escape(table.source)}.</p></div>
"""


def _condition_table(conditions: Sequence[Condition]) -> str:
    words = {True: ("yes", "yes"), False: ("no", "no"), None: ("unknown", "not known")}
    rows = [
        (
            escape(condition.subject),
            escape(condition.published),
            escape(condition.here),
            "<span class='{}'>{}</span>".format(*words[condition.holds]),
        )
        for condition in conditions
    ]
    return html_table(("", "published", "this run", "same"), rows, "words wide")


def _protocol(content: Content) -> str:
    result, model = content.result, content.object
    counts = result.counts
    entries = [
        ("Rules", escape(result.protocol)),
        ("Object", f"{escape(model.title)}, diameter {1000 * model.diameter:.4g} mm"),
        ("Symmetry", escape(result.symmetry)),
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
        *((escape(key.replace("_", " ").capitalize()), _input(entry)) for key, entry in content.inputs.items()),
        (
            "Versions",
            f"evalkit {escape(evalkit_version())}, numpy {np.__version__}, Python {platform.python_version()}",
        ),
    ]
    return f"""<section id="protocol">
<h2>Protocol, counts, hashes</h2>
{facts(entries)}
</section>"""


def _input(entry: dict[str, str]) -> str:
    return f"{escape(entry['file'])}<br><code>sha256 {escape(entry['sha256'])}</code>"
