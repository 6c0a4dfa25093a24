"""Versions of the software that decides the bytes of a dataset."""

from __future__ import annotations

from importlib.metadata import version

from simgen.physics.distribution import BULLET_DISTRIBUTIONS, bullet_version

RENDERING = ("binpose-simgen", "binpose-evalkit", "numpy", "numba", "h5py", "hdf5plugin")


def software_here() -> dict[str, str]:
    """Versions of all of it, as far as it is installed: rendering alone needs no physics engine."""
    return rendering_software() | physics_software()


def rendering_software() -> dict[str, str]:
    """Versions of what turns poses into shards."""
    return {name: version(name) for name in RENDERING}


def physics_software() -> dict[str, str]:
    """Versions of what makes the poses; none where it is not installed."""
    return bullet_version()


def only_physics(software: dict[str, str]) -> dict[str, str]:
    """Those of some versions that belong to what makes the poses."""
    return {name: software[name] for name in BULLET_DISTRIBUTIONS if name in software}
