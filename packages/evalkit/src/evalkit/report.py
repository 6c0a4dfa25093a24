"""One page that shows an evaluation to a person: figures, pictures, rules, all in one HTML file that needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evalkit.evaluation import Result


def save_report(
    path: Path | str,
    predictions_path: Path | str,
    truth_path: Path | str,
    shards: Path | str | Sequence[Path | str] | None = None,
    count: int = 8,
    **rules: Any,
) -> Result:
    """Write the page to `path`, and a PNG and a CSV of every figure to the folder `<stem>_figures` beside it.

    Args:
        shards: where the depth images are, to draw `count` of them with outlines; None draws none.
        rules: as :func:`evalkit.evaluation.average_precision` takes them.

    Raises:
        InputError: a document or a setting cannot be used, or the shards have none of the images.
    """
    raise NotImplementedError
