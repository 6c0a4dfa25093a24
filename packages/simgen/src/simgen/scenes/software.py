"""Versions of the software, and the platform, that decide the bytes of a dataset."""

from __future__ import annotations

import platform
import sys
from importlib.metadata import version

from simgen.physics.engines import ENGINE_DISTRIBUTIONS, engine_version

RENDERING = ("binpose-simgen", "binpose-evalkit", "numpy", "numba", "h5py", "hdf5plugin")
PLATFORM = "platform"  # an engine is another program on each, whose piles differ


def software_here(engine: str) -> dict[str, str]:
    """All of it for piles of that engine, as far as it is installed: rendering alone needs no engine."""
    return rendering_software() | physics_software(engine)


def rendering_software() -> dict[str, str]:
    """Versions of what turns poses into shards."""
    return {name: version(name) for name in RENDERING}


def physics_software(engine: str) -> dict[str, str]:
    """What makes the poses: the engine's version, where it is installed, and the platform."""
    return engine_version(engine) | {PLATFORM: f"{sys.platform} {platform.machine()}"}


def only_physics(software: dict[str, str]) -> dict[str, str]:
    """Those of some versions that belong to what makes the poses."""
    return {name: software[name] for name in (*ENGINE_DISTRIBUTIONS, PLATFORM) if name in software}
