"""A dataset as one HTML page that needs no network: contact sheet, one scene in 3D, histograms, and the config."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.drawing.page import chart_figure, counted, data_uri, facts, page, tile
from simgen.physics.bin import recorded_bin
from simgen.previews.scene_viewer import viewer_figure, viewer_script
from simgen.previews.sheet import contact_sheet, spread_frames
from simgen.previews.survey import CLEAR, Survey, survey
from simgen.previews.survey_charts import survey_charts

PIXEL_FRAMES = 300  # frames whose depth is read; labels are all read
JPEG_QUALITY = 88


def preview_page(dataset: ShardDataset, frames: list[int]) -> str:
    """The page; `frames` are those of the contact sheet, and the scene of the first is shown in 3D."""
    model, found = dataset.header.object, survey(dataset, spread_frames(dataset, PIXEL_FRAMES))
    charts = "".join(chart_figure(chart) for chart in survey_charts(found, model.symmetry.name))
    sections = [
        _header(dataset, found),
        _section("sheet", "Contact sheet", _picture(contact_sheet(dataset, frames))),
        _scene(dataset, frames[0]),
        _section("figures", "What the scenes are like", f"<div class='grid'>{charts}</div>"),
        _section("config", "Config", facts(_config(dataset))),
    ]
    return page(f"{model.title}: {counted(len(dataset), 'frame')}", "\n".join(sections), viewer_script())


def _header(dataset: ShardDataset, found: Survey) -> str:
    header = dataset.header
    model, camera = header.object, header.camera
    clear = np.mean(found.visibility >= CLEAR) if len(found.visibility) else 0.0
    tiles = [
        tile("scenes", f"{len(found.instances):,}", f"seed {header.seed}"),
        tile("frames", f"{len(dataset):,}", f"{camera.width} x {camera.height} pixels"),
        tile("instances a scene", f"{found.instances.mean():.1f}"),
        tile("labels", f"{len(found.visibility):,}", f"{clear:.0%} at least half visible"),
        tile("no return", f"{found.no_return:.2%}", "of the pixels"),
    ]
    return f"""<header>
<p class="kicker">What is in these shards? A preview by simgen {escape(header.software.get("binpose-simgen", ""))}</p>
<h1>{escape(model.title)}</h1>
<p class="soft">diameter {1e3 * model.diameter:.4g} mm, symmetry {escape(model.symmetry.name)}</p>
<nav><a href="#sheet">Contact sheet</a> <a href="#scene">A scene in 3D</a> <a href="#figures">Histograms</a>
<a href="#config">Config</a></nav>
<dl class="tiles">{"".join(tiles)}</dl>
</header>"""


def _section(name: str, title: str, body: str) -> str:
    return f'<section id="{name}">\n<h2>{escape(title)}</h2>\n{body}\n</section>'


def _picture(figure: Figure) -> str:
    written = io.BytesIO()
    figure.savefig(written, format="jpeg", pil_kwargs={"quality": JPEG_QUALITY})
    return f'<figure><img alt="Contact sheet" src="{data_uri("image/jpeg", written.getvalue())}"></figure>'


def _scene(dataset: ShardDataset, frame: int) -> str:
    scene = dataset.scene_index[frame]
    views = [dataset[int(number)] for number in np.flatnonzero(dataset.scene_index == scene)]
    words = f"""<p class="soft">{counted(len(views[0].instances), "instance")} as labelled, and what the
{counted(len(views), "camera")} measured, in colours of the instances.</p>"""
    viewer = viewer_figure(views, dataset.header.object, recorded_bin(dataset.header.config, int(scene)))
    return _section("scene", f"Scene {scene} in 3D", words + viewer)


def _config(dataset: ShardDataset) -> Iterator[tuple[str, str]]:
    header = dataset.header
    document = {
        **header.config,
        "camera": header.camera.to_json(),
        "depth_unit": header.depth_unit,
        "software": header.software,
    }
    for name, value in _flat(document):
        yield escape(name.replace("_", " ")), f"<code>{escape(_written(value))}</code>"


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
