"""One figure: what it shows in words, how it is drawn, and the table of numbers behind it."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import write_text
from evalkit.drawing.plots import INK, new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
WIDTH, HEIGHT = 6.4, 4.0  # inches
RASTERIZED_FROM = 5000  # points; a drawing of more is smaller as pixels


@dataclass(frozen=True, eq=False)
class Chart:
    """One figure. `rows` under `columns` are the numbers that `draw` draws."""

    name: str
    title: str
    caption: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[Any, ...]]
    draw: Callable[[Axes], None]

    def svg(self) -> bytes:
        """The drawing alone, the same bytes each time; the title is left to the page."""
        from matplotlib import rc_context

        figure, written = self._figure(), io.BytesIO()
        axes = figure.axes[0]
        axes.set_title("", loc="left")
        if len(self.rows) > RASTERIZED_FROM:
            for artist in (*axes.lines, *axes.collections):
                artist.set_rasterized(True)
        with rc_context({"svg.hashsalt": self.name}):
            figure.savefig(written, format="svg", metadata={"Date": None})
        return written.getvalue()

    def save(self, folder: Path) -> None:
        """Write the drawing as PNG and its numbers as CSV."""
        save(self._figure(), folder / f"{self.name}.png")
        write_csv(folder / f"{self.name}.csv", self.columns, self.rows)

    def _figure(self) -> Figure:
        figure = new_figure(WIDTH, HEIGHT)
        axes = figure.add_subplot()
        axes.set_title(self.title, loc="left", color=INK)
        self.draw(axes)
        return figure


def binned_rows(edges: NDArray[np.floating[Any]], *counts: NDArray[np.integer[Any]]) -> list[tuple[Any, ...]]:
    """A histogram's table: for each bin its two edges and its number in each of `counts`."""
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), *(count.tolist() for count in counts), strict=True))


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> None:
    """Write a table with one line of headings; None becomes an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    write_text(path, text.getvalue())
