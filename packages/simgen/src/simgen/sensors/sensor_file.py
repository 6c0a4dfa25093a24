"""A sensor on disk, as `simgen sensor fit` writes it. Schema ``binpose-sensor/1``.

A JSON object: ``format``, ``sensor`` with every field of :class:`simgen.sensors.sensor_config.SensorConfig`, and
``fit``, what it was fitted to, for people to read.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from evalkit.atomic import write_json
from evalkit.errors import InputError
from evalkit.json_file import load_json
from evalkit.typed import typed
from simgen.sensors.sensor_config import SensorConfig

FORMAT = "binpose-sensor/1"


def write_sensor(path: Path, sensor: SensorConfig, fit: dict[str, Any]) -> None:
    """Write the sensor and what it was fitted to.

    Raises:
        OSError: the file cannot be written.
    """
    write_json(path, {"format": FORMAT, "sensor": asdict(sensor), "fit": fit})


def read_sensor(path: Path | str) -> SensorConfig:
    """Read a sensor file.

    Raises:
        InputError: it is missing, of another schema, or a parameter is missing, unknown or out of bounds.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such sensor file; make one with 'simgen sensor fit'.")
    document = load_json(path)
    found = document.get("format") if isinstance(document, dict) else None
    if found != FORMAT:
        raise InputError(f"{path}: its format is {found!r}, not {FORMAT!r}; give a file of 'simgen sensor fit'.")
    if set(document) - {"format", "sensor", "fit"}:
        other = ", ".join(sorted(set(document) - {"format", "sensor", "fit"}))
        raise InputError(f"{path}: the field {other} is unknown to this version; use the version that wrote it.")
    return typed(SensorConfig, document.get("sensor"), f"{path}: sensor")
