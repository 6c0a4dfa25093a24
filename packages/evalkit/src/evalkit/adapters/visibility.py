"""How much of each instance is seen, where a dataset does not say: from a file, from the depth images, or all of it.

From the depth images: an instance's silhouette is that of its surface alone, the part beyond the frame included; a
pixel of it is visible where no other annotated instance is nearer and no return lies more than 15 mm in front of the
surface (Hodaň et al. 2016, "On evaluation of 6D object pose estimation", whose tolerance BOP took over). A pixel
without a return counts as visible in the geometric share, as in BOP's since 2019, and not in the returned one. The
surface is drawn as points, dense enough that few pixels are missed. As a pixel counts
where the surface touches it and not only its center, shares come out a little low: by 0.009 on 192 bunnies at 640 x
480, by 0.03 at most.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.fields import numbers
from evalkit.datasets.scene import Share
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.json_file import load_json
from evalkit.objects.model import ObjectModel, sample_surface, surface_moments

Array = NDArray[np.float64]
SYNTAX = "--visibility depth (estimated from the depth images), full (all of every instance) or FILE.json"
ESTIMATED: dict[str, Share] = {"depth": "geometric", "geometric": "geometric", "returned": "returned"}
TOLERANCE = 0.015  # meters
POINTS_PER_PIXEL = 10
MOST_POINTS = 1_000_000
CLOSEST = 0.1  # meters
LARGEST_SIDE = 4000  # pixels of a silhouette; a larger one is too near the camera to be drawn


class Visibility:
    """What the option --visibility says: shares of instances' silhouettes that are seen."""

    def __init__(self, spec: str) -> None:
        """`spec`: full, the name of a JSON file ``{"image id": [share, ...]}``, or depth, which estimates both shares.

        geometric and returned estimate both, too, and say which of them scores go by.

        Raises:
            InputError: the file is not such a document.
        """
        self.spec = spec
        self.share = ESTIMATED.get(spec)
        self.shares = None if spec == "full" or self.share else _read_shares(Path(spec))

    @property
    def remark(self) -> str:
        """What the numbers rest on, as a sentence."""
        if self.spec == "full":
            return "Visibility is not known: every instance counts as fully visible."
        if self.share:
            return f"Visibility is estimated from the depth images and poses, tolerance {1e3 * TOLERANCE:g} mm."
        return f"Visibility is that of {self.spec}."

    def of(
        self, image: str, model: ObjectModel, camera: Camera | None, cam_from_obj: Array, depth: Callable[[], Array]
    ) -> tuple[Array, Array | None]:
        """Shares (n,) of the instances at poses (n, 4, 4): the one that counts, and the other where it is known.

        `depth` reads the image (height, width) in meters.
        """
        if self.shares is not None:
            return numbers(self.shares, image, (len(cam_from_obj),), self.spec), None
        if self.spec == "full":
            return np.ones(len(cam_from_obj)), None
        if len(cam_from_obj) == 0:
            return np.zeros(0), np.zeros(0)
        if camera is None:
            raise InputError(
                "--visibility depth: the dataset's camera is not known; give --visibility full or FILE.json."
            )
        geometric, returned = seen_in_depth(depth(), camera, model, cam_from_obj)
        return (geometric, returned) if self.share == "geometric" else (returned, geometric)


def require_share(asked: str | None, held: Share, field: str) -> None:
    """Of a format that publishes one share in `field`, nothing else can be asked.

    Raises:
        InputError: it was.
    """
    if asked not in (None, held):
        raise InputError(
            f"--visibility {asked}: {field} is {held} visibility, and the format has no other; leave it out."
        )


def seen_in_depth(depth: Array, camera: Camera, model: ObjectModel, cam_from_obj: Array) -> tuple[Array, Array]:
    """Visible shares (n,) of instances at poses (n, 4, 4) in a depth image (height, width) in meters, 0 = no return.

    Returns:
        The geometric and the returned share.

    Raises:
        InputError: the model has no surface, the image is not of the camera's size, or an instance is at the camera.
    """
    if depth.shape != (camera.height, camera.width):
        found = "x".join(str(side) for side in depth.shape[::-1])
        raise InputError(f"the depth image is {found} pixels but the camera's is {camera.width}x{camera.height}.")
    drawn = [_draw(model, camera, pose) for pose in cam_from_obj]
    nearest = np.full(camera.height * camera.width, np.inf)
    for _, pixel, z in drawn:
        nearest[pixel] = np.minimum(nearest[pixel], z)
    measured = depth.ravel()
    geometric, returned = np.zeros((2, len(drawn)))
    for i, (pixels_full, pixel, z) in enumerate(drawn):
        has_return = measured[pixel] > 0
        seen = (z <= nearest[pixel]) & (~has_return | (z - measured[pixel] <= TOLERANCE))
        geometric[i], returned[i] = seen.sum() / max(pixels_full, 1), (seen & has_return).sum() / max(pixels_full, 1)
    return geometric, returned


def _draw(model: ObjectModel, camera: Camera, cam_from_obj: Array) -> tuple[int, NDArray[np.int64], Array]:
    """Pixels of the whole silhouette, and those within the frame as flat indices with their depth."""
    distance = float(model.centers(cam_from_obj)[2])  # the frame's origin may lie anywhere, even behind the camera
    too_near = f"--visibility depth: an instance {distance:.3g} m in front of the camera is too near to be drawn."
    if distance <= 0:
        raise InputError(too_near)
    points = poses.apply(cam_from_obj, _dense_points(model, camera, distance))
    u, v = np.round(camera.project(points)).T
    if points[:, 2].min() <= 0 or max(np.ptp(u), np.ptp(v)) > LARGEST_SIDE:
        raise InputError(too_near)
    width = int(np.ptp(u)) + 1
    front = np.full((int(np.ptp(v)) + 1) * width, np.inf)
    np.minimum.at(front, ((v - v.min()) * width + u - u.min()).astype(np.int64), points[:, 2])
    hit = np.flatnonzero(np.isfinite(front))
    z = front[hit]
    v_full, u_full = hit // width + int(v.min()), hit % width + int(u.min())
    inside = (u_full >= 0) & (u_full < camera.width) & (v_full >= 0) & (v_full < camera.height)
    return len(z), v_full[inside] * camera.width + u_full[inside], z[inside]


def _dense_points(model: ObjectModel, camera: Camera, distance: float) -> Array:
    if model.vertices is None or model.faces is None:
        raise InputError("--visibility depth: the object's surface is needed; give its --mesh and --units.")
    area = surface_moments(model.vertices, model.faces)[0] * camera.fx * camera.fy / max(distance, CLOSEST) ** 2
    return sample_surface(model.vertices, model.faces, int(np.clip(POINTS_PER_PIXEL * area, 1000, MOST_POINTS)))


def _read_shares(path: Path) -> dict[str, object]:
    if path.suffix != ".json":
        raise InputError(f"--visibility {path}: use {SYNTAX}.")
    document = load_json(path)
    if not isinstance(document, dict):
        raise InputError(f'{path}: expected {{"image id": [share, ...]}}, one share between 0 and 1 an instance.')
    for image, shares in document.items():
        if not isinstance(shares, list) or not all(_is_share(share) for share in shares):
            raise InputError(f"{path}: image '{image}': every share must be a number between 0 and 1.")
    return document


def _is_share(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1
