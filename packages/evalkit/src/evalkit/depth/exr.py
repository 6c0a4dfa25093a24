"""Depth in OpenEXR files, as renderers write it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

MEND = "write depth alone, or as the channel Z"


def read_exr(path: Path) -> NDArray[Any]:
    """The depth channel (height, width): the only one, one called Z, V, Y or depth, or gray in R, G and B.

    Raises:
        InputError: OpenEXR is not installed, the file is damaged, or no channel is depth.
    """
    try:
        import OpenEXR
    except ImportError:
        raise InputError(
            f"{path}: reading EXR needs the OpenEXR package: pip install 'binpose-evalkit[exr]', or save a TIFF."
        ) from None
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError) as error:
        raise InputError(f"{path}: is no readable EXR image ({str(error)[:120]}); save it again.") from None
    return _depth_of(channels, path)


def _depth_of(channels: dict[str, NDArray[Any]], path: Path) -> NDArray[Any]:
    if len(channels) == 1:
        return next(iter(channels.values()))
    last = {name: name.rsplit(".", 1)[-1].lower() for name in channels}
    depth = [
        name for name in channels if last[name] in ("z", "depth") or ("depth" in name.lower() and last[name] == "v")
    ]
    if len(depth) == 1:
        return channels[depth[0]]
    color = [name for name in channels if last[name] in ("r", "g", "b")]
    if not depth and len(color) == 3 and all(np.array_equal(channels[n], channels[color[0]]) for n in color):
        return channels[color[0]]
    raise InputError(f"{path}: which of its channels ({', '.join(sorted(channels))[:80]}) is depth? {MEND}.")
