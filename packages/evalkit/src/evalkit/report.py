"""An evaluation as one HTML page that needs no network: figures, pictures, rules and what others published."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evalkit.documents import GroundTruth, Predictions
from evalkit.evaluation import Result, average_precision


def figures_folder(path: Path | str) -> Path:
    """Where the figures of the page at `path` go."""
    return Path(path).with_name(f"{Path(path).stem}_figures")


def save_report(
    path: Path | str,
    predictions: Predictions,
    truth: GroundTruth,
    shards: Path | str | Sequence[Path | str] | None = None,
    count: int = 8,
    inputs: dict[str, dict[str, str]] | None = None,
    **rules: Any,
) -> Result:
    """Write the page to `path`, and a PNG and a CSV of every figure to :func:`figures_folder`.

    Args:
        shards: where the depth images are, to draw `count` of them with outlines; None draws none.
        inputs: names and SHA-256 of the files that the documents were read from.
        rules: as :func:`evalkit.evaluation.average_precision` takes them.

    Raises:
        InputError: a document or a setting cannot be used, or the shards have none of the images.
    """
    return average_precision(predictions, truth, **rules)
