"""A fitted sensor as one HTML page: the camera's figures beside the twin's, their images, and the parameters."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from evalkit.drawing.chart import Chart
from evalkit.drawing.page import render_page
from evalkit.drawing.plots import GRAY, INK, LINE, legend_below, new_figure, tidy
from simgen.scenes.software import rendering_software
from simgen.sensor_fit.fit import FittedSensor
from simgen.sensor_fit.frames import FitFrames
from simgen.sensor_fit.statistics import BESIDE, LAGS, SLOPES
from simgen.sensor_fit.twin_agreement import rows

JPEG_QUALITY = 90
SIDES = ("nearer surface on the right", "nearer surface on the left", "on the nearer surface")
Array = NDArray[np.float64]


def fit_page(fitted: FittedSensor, frames: FitFrames) -> str:
    """The page."""
    figures = list(rows(fitted.real, fitted.twin, frames.camera.fx, fitted.heap))
    heaps = fitted.heap is not None
    judged = [row for row in figures if row.judged]
    parameters = {key: value for key, value in asdict(fitted.sensor).items() if key != "model"}
    agreeing = sum(row.agrees for row in judged)
    nearest, farthest = frames.distances
    return render_page(
        "simgen.sensor_fit",
        "fit.html",
        version=rendering_software().get("binpose-simgen", ""),
        name=fitted.sensor.model,
        about=fitted.sensor.describe(frames.camera, nearest, farthest).split(" (")[0] + ".",
        tiles=[
            ("images", f"{len(frames.depths)}", "of one scene" if frames.static else "of several scenes"),
            ("figures that agree", f"{agreeing} of {len(judged)}", "of those that rest on 300 pixels"),
            ("distance", f"{nearest:.2f}–{farthest:.2f} m"),
            ("no return", f"{fitted.real.missing_all:.1%}", f"twin: {fitted.twin.missing_all:.1%}"),
        ],
        images=_images(fitted, frames),
        charts=list(_charts(fitted, frames.camera.fx)),
        rows=[
            (
                row.name,
                _number(row.real, row.unit),
                _number(row.twin, row.unit),
                *([_number(row.heap, row.unit)] if heaps else []),
                f"± {row.tolerance:.2g} {row.unit}",
                ("agrees" if row.agrees else "differs") if row.judged else "too few pixels",
            )
            for row in figures
        ],
        head=("figure", "camera", "twin", *(["heaps of the part"] if heaps else []), "twin may differ by", ""),
        parameters=[(key.replace("_", " "), f"{value:.5g}") for key, value in parameters.items()],
    )


def _number(value: float, unit: str) -> str:
    return "–" if math.isnan(value) else f"{value:.3g} {unit}"


def _images(fitted: FittedSensor, frames: FitFrames) -> bytes:
    """The first image, its twin, and the surface behind both, as JPEG; black: no return."""
    depth, twin, surface = frames.depths[0], fitted.twins[0], fitted.surfaces[0]
    true = np.where(surface.away, 0, frames.camera.fx / surface.q)
    low, high = np.percentile(depth[depth > 0], [1, 99])
    figure = new_figure(11.0, 11.0 / 3 * depth.shape[0] / depth.shape[1] + 0.4)
    for place, (title, image) in enumerate((("camera", depth), ("twin", twin), ("surface behind both", true))):
        axes = figure.add_subplot(1, 3, place + 1)
        axes.imshow(np.where(image > 0, image, np.nan), cmap=_colors(), vmin=low, vmax=high, interpolation="nearest")
        axes.set_title(title, loc="left", color=INK)
        axes.set_axis_off()
    written = io.BytesIO()
    figure.savefig(written, format="jpeg", pil_kwargs={"quality": JPEG_QUALITY})
    return written.getvalue()


def _colors() -> Any:
    from matplotlib import colormaps

    return colormaps["viridis_r"].with_extremes(bad="black")


def _charts(fitted: FittedSensor, fx: float) -> Iterator[Chart]:
    real, twin = fitted.real, fitted.twin
    scale = 1e3 * float(real.depths[1]) ** 2 / fx
    middles = [(low + high) / 2 for low, high in pairwise(SLOPES)]
    yield _pair(
        "noise", "Noise by slope", f"At {real.depths[1]:.2f} m: what a quadric fitted to 7 x 7 pixels leaves.",
        "degrees", "mm", middles, scale * real.noise, scale * twin.noise,
    )  # fmt: skip
    z = real.depths
    yield _pair(
        "distance", "Noise by distance", "On slopes below 45 degrees, in thirds of the pixels.",
        "meters", "mm", z, 1e3 * z**2 / fx * real.noise_by_distance, 1e3 * z**2 / fx * twin.noise_by_distance,
    )  # fmt: skip
    yield _pair(
        "correlation", "Correlation of the noise", "Between pixels so far apart, of what the local fit leaves.",
        "pixels", "", LAGS, real.correlation, twin.correlation,
    )  # fmt: skip
    yield _pair(
        "missing", "No return by slope", "Away from steps.", "degrees", "share", middles, real.missing, twin.missing
    )
    distances = np.arange(1, BESIDE + 1)
    for side, words in enumerate(SIDES):
        behind = "On" if side == 2 else "Behind a step,"
        caption = f"{behind} {words if side < 2 else 'the nearer side of a step'}: share without a return, in the row."
        yield _pair(
            f"beside-{side}", f"No return beside steps: {words}", caption,
            "pixels from the step", "share", distances, real.beside[side], twin.beside[side],
        )  # fmt: skip


def _pair(
    name: str, title: str, caption: str, across: str, up: str, x: ArrayLike,
    real: Array, twin: Array,
) -> Chart:  # fmt: skip
    return Chart(
        name=name,
        title=title,
        caption=caption,
        columns=(across, "camera", "twin"),
        rows=list(zip(np.asarray(x).tolist(), np.asarray(real).tolist(), np.asarray(twin).tolist(), strict=True)),
        draw=_drawer(x, real, twin, across, up),
    )


def _drawer(x: ArrayLike, real: Array, twin: Array, across: str, up: str) -> Callable[[Axes], None]:
    def draw(axes: Axes) -> None:
        axes.plot(x, real, "o-", color=INK, label="camera")
        axes.plot(x, twin, "s--", color=LINE, label="twin")
        highest = float(np.nanmax(np.concatenate([real, twin, [0.0]])))
        lowest = float(np.nanmin(np.concatenate([real, twin, [0.0]])))
        axes.set(xlabel=across, ylabel=up, ylim=(1.1 * lowest, 1.1 * highest + 1e-9))
        axes.axhline(0, color=GRAY, linewidth=0.8)
        if across.startswith("pixels"):
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        tidy(axes)
        legend_below(axes)

    return draw
