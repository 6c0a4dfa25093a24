"""Versions of the software that decides the bytes of a dataset."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

RENDERING = ("binpose-simgen", "binpose-evalkit", "numpy", "numba", "h5py", "hdf5plugin")
PHYSICS = ("pybullet",)


def software_here() -> dict[str, str]:
    """Versions of all of it, as far as it is installed: rendering alone needs no physics engine."""
    return rendering_software() | _versions(name for name in PHYSICS if _installed(name))


def rendering_software() -> dict[str, str]:
    """Versions of what turns poses into shards."""
    return _versions(RENDERING)


def physics_software() -> dict[str, str]:
    """Versions of what makes the poses.

    Raises:
        PackageNotFoundError: a part of it is not installed.
    """
    return _versions(PHYSICS)


def only_physics(software: dict[str, str]) -> dict[str, str]:
    """Those of some versions that belong to what makes the poses."""
    return {name: software[name] for name in PHYSICS if name in software}


def _versions(names: Iterable[str]) -> dict[str, str]:
    return {name: version(name) for name in names}


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
