"""A dataset as one HTML page that needs no network: contact sheet, one scene in 3D, histograms, and the config."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.drawing.page import render_page
from simgen.physics.bin_size import recorded_bin
from simgen.previews.scene_viewer import scene_json, viewer_script
from simgen.previews.sheet import contact_sheet, spread_frames
from simgen.previews.survey import CLEAR, Survey, survey
from simgen.previews.survey_charts import survey_charts

PIXEL_FRAMES = 300  # frames whose depth is read; labels are all read
JPEG_QUALITY = 88


def preview_page(dataset: ShardDataset, frames: list[int]) -> str:
    """The page; `frames` are those of the contact sheet, and the scene of the first is shown in 3D."""
    header, found = dataset.header, survey(dataset, spread_frames(dataset, PIXEL_FRAMES))
    scene = int(dataset.scene_index[frames[0]])
    views = [dataset[int(number)] for number in np.flatnonzero(dataset.scene_index == scene)]
    return render_page(
        "simgen.previews",
        "preview.html",
        viewer_script(),
        model=header.object,
        frames=len(dataset),
        version=header.software.get("binpose-simgen", ""),
        tiles=_tiles(dataset, found),
        sheet=_jpeg(contact_sheet(dataset, frames)),
        scene=scene,
        views=views,
        scene_json=scene_json(views, header.object, recorded_bin(header.config, scene)),
        charts=survey_charts(found, header.object.symmetry.name),
        config=_config(dataset),
    )


def _tiles(dataset: ShardDataset, found: Survey) -> list[tuple[str, ...]]:
    """Label, value and note of each."""
    camera = dataset.header.camera
    clear = np.mean(found.visibility >= CLEAR) if len(found.visibility) else 0.0
    return [
        ("scenes", f"{len(found.instances):,}", f"seed {dataset.header.seed}"),
        ("frames", f"{len(dataset):,}", f"{camera.width} x {camera.height} pixels"),
        ("instances a scene", f"{found.instances.mean():.1f}"),
        ("labels", f"{len(found.visibility):,}", f"{clear:.0%} at least half visible"),
        ("no return", f"{found.no_return:.2%}", "of the pixels"),
    ]


def _jpeg(figure: Figure) -> bytes:
    written = io.BytesIO()
    figure.savefig(written, format="jpeg", pil_kwargs={"quality": JPEG_QUALITY})
    return written.getvalue()


def _config(dataset: ShardDataset) -> Iterator[tuple[str, str]]:
    header = dataset.header
    document = {
        **header.config,
        "camera": header.camera.to_json(),
        "depth_unit": header.depth_unit,
        "software": header.software,
    }
    for name, value in _flat(document):
        yield name.replace("_", " "), Markup("<code>{}</code>").format(_written(value))


def _written(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value)


def _flat(document: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Entries of nested objects, their names joined with dots."""
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield above + key, value
