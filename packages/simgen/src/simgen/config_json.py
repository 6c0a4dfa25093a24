"""A dataset's config out of the JSON that travels in its files."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from simgen.config import BinSize, BuildConfig, PhysicsConfig, PileConfig, ViewpointConfig
from simgen.sensors.config import SensorConfig

T = TypeVar("T")
PARTS: dict[str, type[Any]] = {
    "bin": BinSize,
    "pile": PileConfig,
    "physics": PhysicsConfig,
    "viewpoints": ViewpointConfig,
    "sensor": SensorConfig,
}
OPTIONAL = ("bin", "sensor")
PLAIN: dict[str, tuple[type, ...]] = {"int": (int,), "float": (int, float), "str": (str,), "bool": (bool,)}


def config_from_json(document: Any, where: str) -> BuildConfig:
    """Read what :meth:`BuildConfig.to_json` wrote; entries that are none of its fields are left aside.

    Raises:
        InputError: a field is missing, unknown to this version, or of the wrong kind; `where` names the place.
    """
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected the config of a dataset.")
    known = {field.name: document[field.name] for field in fields(BuildConfig) if field.name in document}
    values = {name: _part(name, value, f"{where}.{name}") for name, value in known.items()}
    return _checked(BuildConfig, values, where)


def _part(name: str, value: Any, where: str) -> Any:
    if name == "camera":
        return Camera.from_json(value, where)
    if name not in PARTS or (value is None and name in OPTIONAL):
        return value
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected an object with {', '.join(f.name for f in fields(PARTS[name]))}.")
    return _checked(PARTS[name], value, where)


def _checked(kind: type[T], values: dict[str, Any], where: str) -> T:
    """One of the config's dataclasses, all its fields given and of the kind that they are annotated with."""
    annotations = {field.name: str(field.type) for field in fields(kind)}  # type: ignore[arg-type]
    strange = sorted(set(annotations) ^ set(values))
    if strange:
        raise InputError(
            f"{where}: the field '{strange[0]}' is not as this version has it; use the simgen that wrote it."
        )
    for name, value in values.items():
        allowed = PLAIN.get(annotations[name])
        if allowed is not None and (not isinstance(value, allowed) or isinstance(value, bool) != (allowed == (bool,))):
            raise InputError(f"{where}: the field '{name}' is not of type {annotations[name]}.")
    try:
        return kind(**values)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
