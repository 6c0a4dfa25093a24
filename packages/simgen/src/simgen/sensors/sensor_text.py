"""A sensor as it is typed after `--sensor`."""

from __future__ import annotations

from dataclasses import fields, replace

from evalkit.errors import InputError
from simgen.sensors.sensor_config import IDEAL, SENSORS, SensorConfig
from simgen.sensors.sensor_file import read_sensor

SURFACES: dict[str, dict[str, float]] = {  # choices, not measurements: as bad as such parts are known to be
    "shiny": {"fade_degrees": 50.0, "fade_width_degrees": 8.0, "glare_degrees": 6.0, "mirror_share": 0.15},
    "dark": {"fade_degrees": 40.0, "fade_width_degrees": 12.0, "smooth_missing": 0.1},
    "translucent": {"fade_degrees": 65.0, "fade_width_degrees": 8.0, "penetration": 0.002},
}


def parse_sensor(text: str) -> SensorConfig | None:
    """``ideal`` (None), ``stereo``, ``kinect``, a sensor file, or one of these with changes.

    Changes are surfaces and parameters, the later ones win: ``stereo,shiny,baseline=0.1``.

    Raises:
        InputError: there is no such sensor, file or parameter, or a value is not a number within its bounds.
    """
    name, *changes = (part.strip() for part in text.split(","))
    if name == IDEAL and not changes:
        return None
    values: dict[str, float] = {}
    for change in changes:
        values |= SURFACES[change] if change in SURFACES else _changed(text, change)
    return replace(_named(text, name), **values)  # type: ignore[arg-type]


def _named(text: str, name: str) -> SensorConfig:
    if name in SENSORS:
        return SENSORS[name]()
    if name.endswith(".json"):
        return read_sensor(name)
    raise InputError(
        f"--sensor {text}: use {IDEAL}, {', '.join(SENSORS)} or a file of 'simgen sensor fit', as in "
        "--sensor sensor.json or --sensor stereo,baseline=0.1."
    )


def _changed(text: str, change: str) -> dict[str, float]:
    known = [f.name for f in fields(SensorConfig) if f.name != "model"]
    key, _, value = (part.strip() for part in change.partition("="))
    if key not in known:
        raise InputError(
            f"--sensor {text}: '{change}' is neither {', '.join(SURFACES)} nor parameter=value with one of "
            f"{', '.join(known)}."
        )
    try:
        return {key: float(value)}
    except ValueError:
        raise InputError(f"--sensor {text}: '{change}' needs a number, as in {key}=0.1.") from None
