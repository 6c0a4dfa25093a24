"""BOP's lists of what to look for where: ``test_targets_*.json``.

One row is ``{"scene_id", "im_id"}`` and, for 6D localization, ``"obj_id", "inst_count"``. A multi-view list (2025)
gives the views that belong together as ``im_id``: image numbers, or ``[sensor, image number]`` where a scene has
several sensors.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from evalkit.adapters.fields import numbers
from evalkit.errors import InputError
from evalkit.json_file import load_json

Targets = dict[tuple[int, int], set[int] | None]


def read_targets(path: Path, sensor: str | None = None) -> Targets:
    """(scene, image) -> the objects to look for there, None for all; scene by scene, in the file's order.

    Of views that name a sensor, those of `sensor` are taken.

    Raises:
        InputError: it is no such list, or its views name sensors and none is given.
    """
    rows = load_json(path)
    if not isinstance(rows, list):
        raise InputError(f"{path}: expected a list of {{'scene_id', 'im_id', …}}.")
    targets: Targets = {}
    for i, row in enumerate(rows):
        where = f"{path}: target {i}"
        scene = int(numbers(row, "scene_id", (), where))
        for image in _views(row, sensor, where):
            if "obj_id" not in row:
                targets[scene, image] = None
            elif (objects := targets.setdefault((scene, image), set())) is not None:
                objects.add(int(numbers(row, "obj_id", (), where)))
    return _scene_by_scene(targets)


def _views(row: dict[str, Any], sensor: str | None, where: str) -> Iterator[int]:
    views = row.get("im_id")
    for view in views if isinstance(views, list) else [views]:
        if isinstance(view, list) and len(view) == 2 and isinstance(view[0], str):
            if sensor is None:
                raise InputError(f"{where}: its views name sensors; give --sensor {view[0]}, or another.")
            if view[0] != sensor:
                continue
            view = view[1]
        yield int(numbers({"im_id": view}, "im_id", (), where))


def _scene_by_scene(targets: Targets) -> Targets:
    """As the toolkit goes through them, which decides between estimates of equal score."""
    scenes = dict.fromkeys(scene for scene, _ in targets)
    rank = {scene: i for i, scene in enumerate(scenes)}
    return dict(sorted(targets.items(), key=lambda target: rank[target[0][0]]))
