"""Poses drawn where a person can judge them: the object's outline at each pose, over the depth image."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

Image = NDArray[np.uint8]
Color = tuple[int, int, int]
GREEN, RED, BLUE, GRAY, WHITE = (90, 230, 80), (60, 60, 255), (255, 150, 40), (165, 165, 165), (255, 255, 255)  # BGR
NEAR = 1e-3  # meters; triangles that reach nearer are left out
SUBPIXEL_BITS = 4
FARTHEST_PIXEL = 1e6  # keeps fixed-point coordinates within 32 bits
DARKEST, BRIGHTEST = 28.0, 150.0


def draw_poses(
    depth: ArrayLike,
    camera: Camera,
    model: ObjectModel,
    cam_from_obj: ArrayLike,
    colors: Color | Sequence[Color] = GREEN,
    scale: int = 1,
    thickness: int = 1,
    canvas: Image | None = None,
) -> Image:
    """Outlines of the object at poses (n, 4, 4) over a depth image (height, width) in meters, 0 = missing.

    Args:
        colors: BGR, one for all poses or one each.
        scale: pixels of the picture for each of the depth image.
        canvas: what an earlier call returned, to draw more on; else the shaded depth.

    Returns:
        The picture (scale height, scale width, 3), uint8, BGR.

    Raises:
        InputError: the depth image is not of the camera's size, or the model has neither faces nor points.
    """
    picture = shade(depth, camera, scale) if canvas is None else canvas.copy()
    pose = np.asarray(cam_from_obj, float).reshape(-1, 4, 4)
    palette = [colors] * len(pose) if isinstance(colors, tuple) else list(colors)
    view = camera.resized(camera.width * scale, camera.height * scale)
    for one, color in zip(pose, palette, strict=True):
        contours, _ = cv2.findContours(silhouette(model, view, one), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, contours, -1, color, thickness, cv2.LINE_AA)
    return picture


def shade(depth: ArrayLike, camera: Camera, scale: int = 1) -> Image:
    """Depth (height, width) as a gray picture (scale height, scale width, 3): nearer and steeper-lit is brighter.

    Missing depth is black.
    """
    z = np.asarray(depth, np.float32)
    if z.shape != (camera.height, camera.width):
        found = "x".join(str(side) for side in z.shape[::-1])
        raise InputError(f"the depth image is {found} pixels but the camera's is {camera.width}x{camera.height}.")
    known = z > 0
    if not known.any():
        return np.zeros((camera.height * scale, camera.width * scale, 3), np.uint8)
    near, far = np.percentile(z[known], [1, 99])
    nearness = np.clip((far - z) / max(far - near, 1e-6), 0, 1)
    smooth = cv2.GaussianBlur(np.where(known, z, np.median(z[known])), (0, 0), 0.8)
    slope_x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=camera.fx / 8) / smooth
    slope_y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=camera.fy / 8) / smooth
    light = (1 + 0.5 * slope_x + 0.7 * slope_y) / np.sqrt(1.74 * (1 + slope_x**2 + slope_y**2))
    gray = DARKEST + (BRIGHTEST - DARKEST) * (0.45 * nearness + 0.55 * np.clip(light, 0, 1))
    gray = np.where(known, gray, 0).astype(np.uint8)
    gray = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR))


def silhouette(model: ObjectModel, camera: Camera, cam_from_obj: ArrayLike) -> Image:
    """Mask (height, width), 255 where the object at this pose (4, 4) projects; what is behind the camera is left out.

    Triangles below a pixel are set as points, so that a mesh of 70,000 faces takes milliseconds. Without a mesh, the
    convex hull of the model's points.
    """
    mask = np.zeros((camera.height, camera.width), np.uint8)
    if model.vertices is None or model.faces is None:
        return _hull(model, camera, cam_from_obj, mask)
    vertices = poses.apply(cam_from_obj, model.vertices)
    in_front = vertices[:, 2] > NEAR
    pixels = _clamped(camera.project(vertices))
    corners = pixels[model.faces[in_front[model.faces].all(1)]]
    extent = np.ptp(corners, axis=1).max(1)
    low, high = corners.min(1), corners.max(1)
    seen = (high >= -1).all(1) & (low[:, 0] <= camera.width) & (low[:, 1] <= camera.height)
    _set_points(mask, corners[seen & (extent <= 1)].reshape(-1, 2))
    fixed = np.round(corners[seen & (extent > 1)] * (1 << SUBPIXEL_BITS)).astype(np.int32)
    for triangle in fixed:
        cv2.fillConvexPoly(mask, triangle, 255, cv2.LINE_8, SUBPIXEL_BITS)
    return mask


def _hull(model: ObjectModel, camera: Camera, cam_from_obj: ArrayLike, mask: Image) -> Image:
    if model.points is None:
        raise InputError(f"object '{model.title}' has neither a mesh nor points to draw; give the shards or the mesh.")
    points = poses.apply(cam_from_obj, model.points)
    points = points[points[:, 2] > NEAR]
    if len(points) >= 3:
        hull = cv2.convexHull(np.round(_clamped(camera.project(points)) * (1 << SUBPIXEL_BITS)).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 255, cv2.LINE_8, SUBPIXEL_BITS)
    return mask


def _set_points(mask: Image, pixels: NDArray[np.float64]) -> None:
    u, v = np.round(pixels).astype(np.int64).T
    inside = (u >= 0) & (u < mask.shape[1]) & (v >= 0) & (v < mask.shape[0])
    mask[v[inside], u[inside]] = 255


def _clamped(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.clip(np.nan_to_num(pixels), -FARTHEST_PIXEL, FARTHEST_PIXEL)
