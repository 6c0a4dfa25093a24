"""Point pair features (Drost et al. 2010): from depth images to raw hypotheses, by the voting of OpenCV's contrib."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel, sample_surface_with_normals
from peers.smooth_surface import smooth_surface

Cloud = NDArray[np.float32]
SCRIPT = "ppf_voting.py"
STEP = 0.05  # diameters between sampled points
MODEL_POINTS = 20_000  # before they are thinned to that
MILLIMETERS = 1e3


def model_cloud(model: ObjectModel) -> Cloud:
    """Points in millimeters and normals (m, 6) of the object's surface."""
    points, normals = sample_surface_with_normals(*model.mesh, MODEL_POINTS)
    return in_millimeters(thinned(np.concatenate([points, normals], -1), STEP * model.diameter, sides=True))


def scene_cloud(depth: NDArray[np.float32], camera: Camera, model: ObjectModel) -> Cloud:
    """Points in millimeters and normals (n, 6) of what a depth image (H, W) in meters shows."""
    smooth, normals = smooth_surface(depth, camera, model.diameter)
    seen = smooth > 0
    cloud = np.concatenate([camera.point_map(smooth)[seen], normals[seen]], -1)
    return in_millimeters(thinned(cloud, STEP * model.diameter))


def thinned(cloud: NDArray[np.floating], step: float, sides: bool = False) -> NDArray[np.float64]:
    """One point with its normal a cell of a grid, the mean of those (n, 6) that lie in it.

    With `sides`, the surfaces of one cell that face six different ways stay apart: those of a thin wall have no mean.
    """
    cell = np.floor(cloud[:, :3] / step).astype(np.int64)
    if sides:
        normal = cloud[:, 3:]
        axis = np.abs(normal).argmax(1)
        cell = np.column_stack([cell, 2 * axis + (normal[np.arange(len(normal)), axis] > 0)])
    _, of, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(of.ravel(), column) for column in cloud.T], 1) / count[:, None]
    length = np.linalg.norm(mean[:, 3:], axis=1)
    mean[:, 3:] /= np.maximum(length, 1e-9)[:, None]
    return np.asarray(mean[length > 0.5])


def in_millimeters(cloud: NDArray[np.float64]) -> Cloud:
    scaled = cloud.copy()
    scaled[:, :3] *= MILLIMETERS
    return np.ascontiguousarray(scaled, np.float32)
