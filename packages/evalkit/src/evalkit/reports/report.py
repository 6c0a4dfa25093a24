"""An evaluation as one HTML page that needs no network: figures, pictures, rules and what others published."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from evalkit.atomic import atomic_path, write_text
from evalkit.datasets.documents import GroundTruth, Predictions
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.drawing.chart import Chart, write_csv
from evalkit.drawing.evaluation_picture import Confident, frames_by_id, spread, with_mesh_of
from evalkit.drawing.page import require_page_name
from evalkit.errors import InputError
from evalkit.reports import charts
from evalkit.reports.reliability_chart import reliability
from evalkit.reports.report_page import Content, Overlay, render
from evalkit.scoring import breakdown
from evalkit.scoring.bootstrap import intervals, scene_numbers
from evalkit.scoring.breakdown import ImageRow
from evalkit.scoring.evaluation import Subject, average_precision
from evalkit.scoring.result import Result

RESAMPLES = 1000
FEWEST_SCENES = 10  # resamples of fewer say little about chance
Shards = Path | str | Sequence[Path | str]


def save_report(
    path: Path | str,
    predictions: Predictions,
    truth: GroundTruth,
    shards: Shards | None = None,
    count: int = 8,
    inputs: dict[str, dict[str, str]] | None = None,
    **rules: Any,
) -> Result:
    """Write the page to `path`, and a PNG and a CSV of every figure to :func:`figures_folder`.

    Args:
        shards: where the depth images are, to draw `count` of them with outlines; None draws none.
        inputs: names and SHA-256 of the files that the documents were read from.
        rules: as :func:`evalkit.scoring.evaluation.average_precision` takes them.

    Raises:
        InputError: a document or a setting cannot be used, or the shards have none of the images.
    """
    require_page_name(path)
    result = average_precision(predictions, truth, **rules)
    confident = Confident.cut(predictions, truth, result)
    rows = breakdown.image_rows(result, confident.result, predictions)
    scenes = len(np.unique(scene_numbers(result.image_ids)))
    content = Content(
        object=truth.object,
        result=result,
        confident=confident.result,
        score=confident.score,
        intervals=intervals(result, RESAMPLES) if scenes >= FEWEST_SCENES else {},
        scenes=scenes,
        charts=_charts(predictions, truth, result, confident),
        rows=rows,
        overlays=[] if shards is None else _overlays(shards, confident, rows, count),
        inputs=inputs or {},
        folder=figures_folder(path).name,
    )
    page = render(content)
    _save_figures(figures_folder(path), content)
    write_text(path, page)
    return result


def figures_folder(path: Path | str) -> Path:
    """Where the figures of the page at `path` go."""
    return Path(path).with_name(f"{Path(path).stem}_figures")


def _charts(predictions: Predictions, truth: GroundTruth, result: Result, confident: Confident) -> list[Chart]:
    settings = result.settings
    subject = Subject.of(predictions, truth, settings)
    errors = breakdown.pose_errors(truth.object, confident.result)
    return [
        charts.precision_recall(result),
        charts.score_histogram(result, confident.score),
        reliability(result),
        charts.ap_by_threshold(breakdown.by_threshold(subject, settings), result),
        charts.ap_by_criterion(breakdown.by_criterion(subject, settings)),
        charts.rotation_errors(errors),
        charts.translation_errors(errors, truth.object.diameter),
        charts.ap_by_visibility(breakdown.by_visibility(subject, settings), settings),
    ]


def _overlays(shards: Shards, confident: Confident, rows: Sequence[ImageRow], count: int) -> list[Overlay]:
    """Half of them the worst images, half from all over the rest, in the order of the images."""
    dataset = ShardDataset(shards)
    frames = frames_by_id(dataset)
    there = [row for row in rows if row.id in frames]
    if not there:
        raise InputError(f"{shards}: it has none of the images of {confident.truth.source}, such as '{rows[0].id}'.")
    worst = there[: -(-count // 2)]
    by_id = {row.id: row for row in there[len(worst) :]}
    others = spread(sorted(by_id), count - len(worst)) if by_id else []
    model = with_mesh_of(dataset, confident.truth.object)
    chosen = [(row, True) for row in worst] + [(by_id[name], False) for name in others]
    return [Overlay(row, bad, confident.draw(dataset[frames[row.id]], model, row.id)) for row, bad in chosen]


def _save_figures(folder: Path, content: Content) -> None:
    for chart in content.charts:
        chart.save(folder)
    drawn = {overlay.row.id: f"overlay-{number}.png" for number, overlay in enumerate(content.overlays, 1)}
    columns = tuple(ImageRow.__dataclass_fields__)
    rows = [(*(getattr(row, column) for column in columns), drawn.get(row.id)) for row in content.rows]
    write_csv(folder / "images.csv", (*columns, "overlay"), rows)
    for stale in folder.glob("overlay-*.png"):
        stale.unlink()
    for overlay in content.overlays:
        with atomic_path(folder / drawn[overlay.row.id]) as temporary:
            temporary.write_bytes(cv2.imencode(".png", overlay.picture)[1].tobytes())
