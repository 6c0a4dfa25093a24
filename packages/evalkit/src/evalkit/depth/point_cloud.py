"""Point clouds that lie on a camera's pixel grid, as the depth images that they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.depth.pcd import read_pcd
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

Array = NDArray[np.float64]
SUFFIXES = (".ply", ".pcd")
OFF_THE_GRID = 1.5  # pixels, at the median, from where on a cloud is not the camera's
FEWEST = 100  # points that a camera is fitted to
FIT_PIXELS = 0.25  # by which the grid of a cloud misses, at the median, the camera fitted to it


def read_grid(path: Path, camera: Camera | None = None) -> Array:
    """The points (height, width, 3) of an organized cloud, in the file's unit; NaN where nothing returned.

    PCD says its width and height; of PLY, which has no such fields, the count must be that of the camera's pixels, or
    `obj_info` lines tell num_cols and num_rows.

    Raises:
        InputError: the file is no cloud, or lies on no pixel grid.
        OSError: it cannot be read.
    """
    points, (width, height) = read_pcd(path) if path.suffix.lower() == ".pcd" else _read_ply(path)
    if height <= 1 and camera is not None and len(points) == camera.width * camera.height:
        width, height = camera.width, camera.height
    if height <= 1:
        pixels = "" if camera is None else f", and {camera.width} x {camera.height} pixels are not that many"
        raise InputError(
            f"{path}: its {len(points)} points lie on no pixel grid{pixels}; save the cloud organized, with a point "
            "for every pixel, or save the depth image."
        )
    grid = points.reshape(height, width, 3).copy()
    grid[~(np.isfinite(grid).all(-1) & (grid[..., 2] > 0))] = np.nan
    return grid


def require_camera(grid: Array, camera: Camera, path: Path) -> None:
    """Check that points lie where the camera's pixels look; a cloud in another frame or of another camera does not.

    Raises:
        InputError: they do not.
    """
    height, width = grid.shape[:2]
    if (width, height) != (camera.width, camera.height):
        return  # the size is checked with all other images
    v, u = np.mgrid[:height, :width]
    seen = ~np.isnan(grid[..., 2])
    if not seen.any():
        return
    miss = np.linalg.norm(camera.project(grid[seen]) - np.stack([u, v], -1)[seen], axis=-1)
    if np.median(miss) > OFF_THE_GRID:
        raise InputError(
            f"{path}: its points lie {np.median(miss):.3g} pixels off the camera's grid; give the camera that took the "
            "cloud, and the cloud in that camera's frame (x right, y down, z forward)."
        )


def fitted_camera(grid: Array, path: Path) -> Camera:
    """The pinhole camera on whose pixels the points lie, by least squares.

    Raises:
        InputError: there are too few points, or they lie on no pinhole camera's grid.
    """
    height, width = grid.shape[:2]
    v, u = np.mgrid[:height, :width]
    seen = ~np.isnan(grid[..., 2])
    fits = []
    for axis, pixels in ((0, u), (1, v)):
        slope = (grid[..., axis] / grid[..., 2])[seen]
        design = np.stack([slope, np.ones_like(slope)], -1)
        (focal, center), *_ = np.linalg.lstsq(design, pixels[seen].astype(float), rcond=None)
        miss = np.median(np.abs(design @ [focal, center] - pixels[seen])) if seen.sum() >= FEWEST else np.inf
        if not (focal > 0 and miss <= FIT_PIXELS):
            raise InputError(
                f"{path}: its points lie on no pinhole camera's grid; give --camera, and the cloud in that camera's "
                "frame (x right, y down, z forward)."
            )
        fits.append((float(focal), float(center)))
    (fx, cx), (fy, cy) = fits
    return Camera(width, height, fx, fy, cx, cy)


def _read_ply(path: Path) -> tuple[Array, tuple[int, int]]:
    from plyfile import PlyData, PlyParseError

    try:
        document = PlyData.read(str(path))
        vertices = document["vertex"]
        points = np.stack([np.asarray(vertices[axis], float) for axis in "xyz"], -1)
    except (PlyParseError, KeyError, ValueError) as error:
        raise InputError(f"{path}: is no readable PLY point cloud ({str(error)[:120]}); save it again.") from None
    words = [line.split() for line in [*document.obj_info, *document.comments]]
    stated = {row[0].lower(): int(row[1]) for row in words if len(row) == 2 and row[1].isdecimal()}
    width = stated.get("num_cols", stated.get("width", 0))
    height = stated.get("num_rows", stated.get("height", 0))
    return points, (width, height) if width * height == len(points) else (len(points), 1)
