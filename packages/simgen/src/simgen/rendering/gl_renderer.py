"""Depth images by OpenGL, through pyrender: what `rasterizer.py` draws, on whatever OpenGL there is.

pyrender takes four samples a pixel and reads the depth of one of them, (0.125, 0.375) px off the pixel's center; here
it takes one, at the center.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.rendering.gl_platform import require_gl
from simgen.rendering.rasterizer import BEYOND_FRAME, NEAR_PER_EXTENT, Rendering

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
MARGIN = 1e-3  # between the mesh and the clipping planes, as a share of the depth
MOST_RANGE = 200.0  # far over near plane at most, or 24 bits of depth could not tell a tenth of a millimeter


class GlRenderer:
    """Renders instances of one mesh before a static background, as :class:`Rasterizer` does.

    Raises:
        InputError: pyrender or OpenGL is missing.
    """

    def __init__(
        self,
        camera: Camera,
        vertices: Array,
        faces: NDArray[np.int32],
        background: tuple[Array, NDArray[np.int32]] | None = None,
    ) -> None:
        require_gl()
        self._camera = camera
        self._depth_of = _DepthBuffer(camera.width, camera.height)
        self._vertices, self._mesh = vertices, _mesh_of(vertices, faces)
        self._near = NEAR_PER_EXTENT * float(np.linalg.norm(np.ptp(vertices, axis=0))) / 2
        self._background: Any = None
        if background is not None:
            self.set_background(*background)

    def set_background(self, vertices: Array, faces: NDArray[np.int32]) -> None:
        """Put another background, vertices (B, 3) in meters, world frame, behind all instances from now on."""
        self._background_vertices, self._background = vertices, _mesh_of(vertices, faces)

    def render(self, cam_from_obj: Array, cam_from_world: Array) -> Rendering:
        """One frame: poses of the instances (n, 4, 4) and of the world (4, 4)."""
        camera, count = self._camera, len(cam_from_obj)
        depth: NDArray[np.float32] = np.zeros((camera.height, camera.width), np.float32)
        if self._background is not None:
            behind = poses.apply(cam_from_world, self._background_vertices)
            depth = self._depth_of.mesh(self._background, cam_from_world, camera, _range(behind, self._near))
        ids = np.zeros(depth.shape, np.uint16)
        pixels_full, box_full = np.zeros(count, np.int32), np.zeros((count, 4), np.int32)
        for row, pose in enumerate(cam_from_obj):
            drawn, corner = self._draw_instance(pose)
            rows, columns = np.nonzero(drawn)
            if len(rows):
                pixels_full[row] = len(rows)
                x0, y0 = columns.min() + corner[0], rows.min() + corner[1]
                box_full[row] = x0, y0, columns.max() + corner[0] + 1, rows.max() + corner[1] + 1
                _composite(drawn, corner, row + 1, depth, ids)
        return Rendering(depth, ids, pixels_full, box_full)

    def _draw_instance(self, cam_from_obj: Array) -> tuple[NDArray[np.float32], tuple[int, int]]:
        """Its depth alone in the part of the image that it lies in, and that part's first column and row."""
        points = poses.apply(cam_from_obj, self._vertices)
        if points[:, 2].max() <= self._near:
            return np.zeros((0, 0), np.float32), (0, 0)
        box = self._box(points)
        drawn = np.zeros((box[3] - box[1], box[2] - box[0]), np.float32)
        planes = _range(points, self._near)
        for x, y in _tiles(box, self._camera):
            tile = self._depth_of.mesh(self._mesh, cam_from_obj, _shifted(self._camera, x, y), planes)
            part = drawn[y - box[1] :, x - box[0] :][: tile.shape[0], : tile.shape[1]]
            part[:] = tile[: part.shape[0], : part.shape[1]]
        return drawn, (box[0], box[1])

    def _box(self, points: Array) -> Box:
        """Pixels that the mesh may cover: all, unless it is larger than the window around the frame."""
        width, height = self._camera.width, self._camera.height
        aside, above = BEYOND_FRAME * width, BEYOND_FRAME * height
        window = (-aside, -above, width + aside, height + above)
        if points[:, 2].min() <= self._near:
            return window
        pixels = self._camera.project(points)
        (x0, y0), (x1, y1) = np.floor(pixels.min(0)).astype(int), np.ceil(pixels.max(0)).astype(int) + 1
        if x1 - x0 <= 3 * width and y1 - y0 <= 3 * height:
            return x0, y0, x1, y1
        x0, y0 = max(x0, window[0]), max(y0, window[1])
        return x0, y0, max(x0, min(x1, window[2])), max(y0, min(y1, window[3]))


class _DepthBuffer:
    """Draws the depth of one mesh, in images of a fixed size."""

    def __init__(self, width: int, height: int) -> None:
        import pyrender

        self._pyrender, self._offscreen = pyrender, _offscreen(width, height)

    def mesh(self, mesh: Any, cam_from_mesh: Array, camera: Camera, planes: tuple[float, float]) -> NDArray[np.float32]:
        """Axial meters (height, width), 0 where there is nothing, between the near and far `planes`."""
        pyrender = self._pyrender
        near, far = planes
        scene = pyrender.Scene()
        scene.add(mesh, pose=GL_FROM_CV @ cam_from_mesh)
        cx, cy = camera.cx + 0.5, camera.cy + 0.5  # OpenGL counts from the pixel's corner
        scene.add(pyrender.IntrinsicsCamera(camera.fx, camera.fy, cx, cy, near, far), pose=np.eye(4))
        flags = pyrender.RenderFlags.DEPTH_ONLY | pyrender.RenderFlags.SKIP_CULL_FACES
        return np.array(self._offscreen.render(scene, flags), np.float32)


@cache
def _offscreen(width: int, height: int) -> Any:
    """This process's OpenGL context for that size, kept to the end: pyrender shuts down all of EGL with any of them."""
    import pyrender  # not before: it reads which platform to use

    offscreen = pyrender.OffscreenRenderer(width, height)
    _take_one_sample(offscreen, width, height)
    return offscreen


def _take_one_sample(offscreen: Any, width: int, height: int) -> None:
    """Put single-sample storage into the buffers that pyrender draws into, which it makes only once for a size."""
    from OpenGL import GL

    offscreen._platform.make_current()
    renderer = offscreen._renderer
    renderer._configure_main_framebuffer()
    for buffer, kind in ((renderer._main_cb_ms, GL.GL_RGBA), (renderer._main_db_ms, GL.GL_DEPTH_COMPONENT24)):
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, width, height)


def _mesh_of(vertices: Array, faces: NDArray[np.int32]) -> Any:
    import pyrender

    return pyrender.Mesh([pyrender.Primitive(positions=vertices, indices=faces)])


def _range(points: Array, nearest: float) -> tuple[float, float]:
    """Near and far plane around points (n, 3) of the camera's frame."""
    far = max((1 + MARGIN) * float(points[:, 2].max()), 2 * nearest)
    return max((1 - MARGIN) * float(points[:, 2].min()), nearest, far / MOST_RANGE), far


def _tiles(box: Box, camera: Camera) -> Iterator[tuple[int, int]]:
    """First column and row of the frames that cover the box."""
    for row in range(math.ceil((box[3] - box[1]) / camera.height)):
        for column in range(math.ceil((box[2] - box[0]) / camera.width)):
            yield box[0] + column * camera.width, box[1] + row * camera.height


def _shifted(camera: Camera, x: int, y: int) -> Camera:
    """The camera whose pixel (0, 0) is this one's (x, y)."""
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx - x, camera.cy - y)


def _composite(
    drawn: NDArray[np.float32],
    corner: tuple[int, int],
    identity: int,
    depth: NDArray[np.float32],
    ids: NDArray[np.uint16],
) -> None:
    """Put what is nearest into the frame."""
    x0, y0 = max(corner[0], 0), max(corner[1], 0)
    part = drawn[y0 - corner[1] :, x0 - corner[0] :][: max(depth.shape[0] - y0, 0), : max(depth.shape[1] - x0, 0)]
    rows, columns = slice(y0, y0 + part.shape[0]), slice(x0, x0 + part.shape[1])
    nearer = (part > 0) & ((depth[rows, columns] == 0) | (part < depth[rows, columns]))
    depth[rows, columns][nearer] = part[nearer]
    ids[rows, columns][nearer] = identity
