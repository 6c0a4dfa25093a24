"""Figures: their colors and frames, and how they are written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from evalkit.atomic import atomic_path
from evalkit.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINE, FILL, INK, GRAY = "#1f5fa8", "#1f5fa822", "#444444", "#9aa1a9"
SUFFIXES = (".png", ".svg", ".pdf")


def tidy(axes: Axes) -> None:
    """A pale grid behind the data, and no frame around it."""
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend_below(axes: Axes) -> None:
    """The legend beneath the drawing, where it hides nothing; the figure is one of :func:`new_figure`."""
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)


def new_figure(width: float, height: float) -> Figure:
    """A figure that needs no display, in inches."""
    from matplotlib.figure import Figure  # slow to import, and most commands draw nothing

    return Figure(figsize=(width, height), layout="constrained", dpi=150)


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure atomically in the format that the suffix names.

    Raises:
        InputError: the suffix names none that we write.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: a picture's name must end in one of {', '.join(SUFFIXES)}.")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=suffix[1:])
