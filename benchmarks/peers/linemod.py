"""Linemod (Hinterstoisser et al. 2011) on depth alone: templates of quantized normals from rendered views of the mesh.

The views come from all sides, at all turns in the image, and at the distances that the depth images to be searched
have. A match says template and pixel; the template's surface, held against the depth there, says the distance, and how
much of it is there. Normals in eight bins match in many places, so a match is as strong as its similarity times that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.depth_views import sphere_directions
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym
from peers.clustering import apart
from simgen.rendering.rasterizer import Rasterizer

Array = NDArray[np.float64]
SCRIPT = "linemod_matching.py"
DIRECTIONS = 162  # about 16 degrees from each other
TURNS = 22  # in the image, as far apart
DISTINCT = 0.04  # diameters of Sym: views nearer than this look the same
SCALE = 1.12  # of one distance to the next
MARGIN = 1.25  # side of a template's image over the object's largest projection
SAMPLES = 200  # pixels of a template that are held against the depth
TOLERANCE = 0.06  # diameters: depth agrees within this, for a template is turned by some degrees from what is seen
SURFACE_STEP = 0.15  # diameters: depth that differs by more belongs to another surface
LARGEST = 110.0  # pixels: objects that are larger in the image are searched for in a coarser one
PLACE, PLACE_MOST = 0.2, 20  # diameters of a place's side, and matches that are looked into there
APART = 0.3  # diameters between the centers of two detections


@dataclass(frozen=True, eq=False)
class Templates:
    """n views of an object, its center in the middle of the image.

    Attributes:
        rotation: (n, 3, 3). distance: (n,) of the center, meters. depth: (n, S, S) meters, 0 beside the object.
        unit: meters a step of the whole numbers that the matcher gets.
    """

    model: ObjectModel
    rotation: Array
    distance: Array
    depth: NDArray[np.float32]
    unit: float

    @classmethod
    def rendered(cls, model: ObjectModel, camera: Camera, nearest: float, farthest: float) -> Templates:
        """By simgen's rasterizer, with the focal lengths of `camera`, for depths of `nearest` to `farthest` meters."""
        nearest = max(nearest, 1.1 * model.diameter)
        steps = max(1, round(np.log(max(farthest / nearest, 1.0)) / np.log(SCALE)))
        distances = np.geomspace(nearest, max(farthest, nearest), steps + 1)
        distances = np.sqrt(distances[1:] * distances[:-1])
        focal = max(camera.fx, camera.fy)
        side = int(np.ceil(MARGIN * focal * model.diameter / (distances[0] - model.diameter / 2) / 32)) * 32
        middle = (side - 1) / 2
        rasterizer = Rasterizer(Camera(side, side, camera.fx, camera.fy, middle, middle), *model.mesh)
        rotation = np.concatenate([view_rotations(model)] * len(distances))
        distance = np.repeat(distances, len(rotation) // len(distances))
        depth = np.zeros((len(rotation), side, side), np.float32)
        for row, pose in enumerate(centered_at(model, rotation, distance[:, None] * [0.0, 0.0, 1.0])):
            depth[row] = rasterizer.render(pose[None], np.eye(4)).depth
        return cls(model, rotation, distance, depth, max(1e-4, (farthest + model.diameter) / 60_000))

    def whole_numbers(self, depth: NDArray[np.floating]) -> NDArray[np.uint16]:
        """Depth in meters as the matcher reads it."""
        return np.asarray(np.minimum(np.round(depth / self.unit), 65_535), np.uint16)

    def poses(
        self, depth: NDArray[np.float32], camera: Camera, template: NDArray[np.int64], corner: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Poses (k, 4, 4) of matches on a depth image (H, W), and the share (k,) of the templates' surfaces it shows.

        Args:
            template: (k,) rows. corner: (k, 2) pixels x, y where the corner of the template's image lies.
        """
        shift, agreement = np.zeros(len(template)), np.zeros(len(template))
        reach = SURFACE_STEP * self.model.diameter + (SCALE - 1) * self.distance
        for row in np.unique(template):
            of_row = np.flatnonzero(template == row)
            surface = np.argwhere(self.depth[row] > 0)
            surface = surface[np.linspace(0, len(surface) - 1, SAMPLES).astype(int)]
            at = surface[None] + corner[of_row, None, ::-1]
            inside = ((at >= 0) & (at < depth.shape)).all(-1)
            y, x = np.where(inside[..., None], at, 0).transpose(2, 0, 1)
            gap = depth[y, x] - self.depth[row][surface[:, 0], surface[:, 1]]
            seen = inside & (depth[y, x] > 0) & (np.abs(gap) < reach[row])
            known = seen.any(1)
            middle = np.zeros(len(of_row))
            middle[known] = np.nanmedian(np.where(seen, gap, np.nan)[known], 1)
            near = seen & (np.abs(gap - middle[:, None]) < TOLERANCE * self.model.diameter)
            shift[of_row], agreement[of_row] = middle, near.mean(1)
        u, v = (corner + (self.depth.shape[1] - 1) / 2).T
        ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], -1)
        turn = poses.rotation_between(np.broadcast_to([0.0, 0.0, 1.0], ray.shape), ray)
        center = ray * (self.distance[template] + shift)[:, None]
        return centered_at(self.model, turn @ self.rotation[template], center), agreement


def coarser(camera: Camera, diameter: float, nearest: float) -> tuple[Camera, int]:
    """The camera of an image of every k-th pixel, and k, with which an object at `nearest` meters is small enough."""
    every = max(1, round(max(camera.fx, camera.fy) * diameter / nearest / LARGEST))
    first = every // 2
    width, height = ((side - first + every - 1) // every for side in (camera.width, camera.height))
    focal = (camera.fx / every, camera.fy / every)
    return Camera(width, height, *focal, (camera.cx - first) / every, (camera.cy - first) / every), every


def view_rotations(model: ObjectModel) -> Array:
    """Rotations (n, 3, 3) of the views; of those that the object's symmetry makes equal one."""
    tilt = poses.rotation_between(sphere_directions(DIRECTIONS), [0.0, 0.0, -1.0])
    angle = np.arange(TURNS) * (2 * np.pi / TURNS)
    turn = poses.from_axis_angle(np.broadcast_to([0.0, 0.0, 1.0], (TURNS, 3)), angle)
    rotation = (turn[None] @ tilt[:, None]).reshape(-1, 3, 3)
    posed = centered_at(model, rotation, np.zeros((len(rotation), 3)))
    distance = Sym(model)
    kept: list[int] = []
    for row, pose in enumerate(posed):
        if not kept or distance(pose[None], posed[kept]).min() >= DISTINCT * model.diameter:
            kept.append(row)
    return np.asarray(rotation[kept])


def centered_at(model: ObjectModel, rotation: Array, center: Array) -> Array:
    """Poses (n, 4, 4) with rotations (n, 3, 3) whose object has its centroid at `center` (n, 3)."""
    return np.asarray(poses.from_rotation_translation(rotation, center - rotation @ model.centroid))


def detections(cam_from_obj: Array, similarity: Array, model: ObjectModel) -> tuple[Array, Array]:
    """Of poses (n, 4, 4) the best one about each place (m, 4, 4), with its similarity (m,), best first."""
    order = np.argsort(-similarity, kind="stable")
    kept = order[apart(model.centers(cam_from_obj[order]), APART * model.diameter)]
    return cam_from_obj[kept], similarity[kept]


def spread_out(cam_from_obj: Array, strength: Array, model: ObjectModel) -> NDArray[np.int64]:
    """Rows of poses (n, 4, 4), best first, of which no place in space has more than PLACE_MOST."""
    order = np.argsort(-strength, kind="stable")
    place = np.floor(model.centers(cam_from_obj[order]) / (PLACE * model.diameter)).astype(np.int64)
    of = np.unique(place, axis=0, return_inverse=True)[1].ravel()
    by_place = np.argsort(of, kind="stable")
    rank = np.empty(len(of), np.int64)
    rank[by_place] = np.arange(len(of)) - np.searchsorted(of[by_place], of[by_place])
    return np.asarray(order[rank < PLACE_MOST])
