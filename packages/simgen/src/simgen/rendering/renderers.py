"""The depth renderers, by the names that a config knows them by."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from simgen.rendering.rasterizer import Rasterizer, Rendering

Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]


class DepthRenderer(Protocol):
    """Renders instances of one mesh before a static background; see :class:`simgen.rendering.rasterizer.Rasterizer`."""

    def set_background(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None: ...

    def render(self, cam_from_obj: NDArray[np.float64], cam_from_world: NDArray[np.float64]) -> Rendering: ...


def depth_renderer(name: str, camera: Camera, mesh: Mesh) -> DepthRenderer:
    """The renderer of one of `config.RENDERERS`, for a mesh in the object's frame; without a background yet.

    Raises:
        InputError: what it needs is not installed.
    """
    if name == "pyrender":
        from simgen.rendering.gl_renderer import GlRenderer

        return GlRenderer(camera, *mesh)
    return Rasterizer(camera, *mesh)
