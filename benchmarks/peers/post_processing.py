"""What makes PPF+PP and Linemod+PP: raw hypotheses are fitted to the depth image, scored by it, and verified as a set.

All are fitted by projective point-to-plane ICP, from afar and from near, of which the better fit stays. A pose's score
is the share of its surface that the image shows where the pose has it, less the share that the camera looks through.
Best first, a pose whose depth better ones explain already is left out. ICP and evidence are those of posenet's
refinement; its turned starts and its learned judge, which a classical pipeline does not have, are not used.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel, sample_surface_with_normals, surface_moments
from peers.smooth_surface import smooth_surface
from posenet.refinement.depth_evidence import ALREADY_EXPLAINED, depth_evidence, explained_before
from posenet.refinement.icp import icp

Array = NDArray[np.float64]
POINTS = 500  # of the surface
ITERATIONS = 20
REACHES = ((0.15, 0.03), (0.05, 0.02))  # diameters: farthest point that ICP draws to, first and last; wide and narrow
TOLERANCE = 0.04  # diameters: depth agrees within this
MOST = 1500  # hypotheses of an image, the strongest ones


class PostProcessing:
    """Fits, scores and verifies poses of one object, which has a mesh."""

    def __init__(self, model: ObjectModel) -> None:
        self.model = model
        vertices, faces = model.mesh
        self.points, self.normals = sample_surface_with_normals(vertices, faces, POINTS)
        self.spacing = float(np.sqrt(surface_moments(vertices, faces)[0] / POINTS))

    def process(
        self, depth: NDArray[np.float32], camera: Camera, cam_from_obj: Array, strength: Array
    ) -> tuple[Array, Array]:
        """Of hypotheses (n, 4, 4) with votes or similarities (n,) the verified poses (m, 4, 4) and scores (m,)."""
        strongest = np.argsort(-strength, kind="stable")[:MOST]
        if len(strongest) == 0:
            return np.zeros((0, 4, 4)), np.zeros(0)
        tolerance = TOLERANCE * self.model.diameter
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        smooth, normals = smooth_surface(depth, camera, self.model.diameter)
        tried = []
        for reach in REACHES:
            fitted = self._fitted(cam_from_obj[strongest], smooth, normals, intrinsics, reach)
            agreement, violation = depth_evidence(
                fitted, self.points, self.normals, depth, normals, intrinsics, tolerance
            )
            tried.append((fitted, agreement - violation))
        best = np.argmax([score for _, score in tried], 0)
        row = np.arange(len(strongest))
        fitted, score = (np.stack(parts)[best, row] for parts in zip(*tried, strict=True))
        order = np.argsort(-score, kind="stable")
        explained = explained_before(
            fitted, order, np.zeros(len(order), np.int64), self.points[None], self.normals[None], depth, intrinsics,
            np.array([tolerance]), np.array([self.spacing]),
        )  # fmt: skip
        kept = order[explained[order] <= ALREADY_EXPLAINED]
        return fitted[kept], score[kept]

    def _fitted(
        self, cam_from_obj: Array, depth: Any, normals: Any, intrinsics: Array, reach: tuple[float, float]
    ) -> Array:
        moved, size = np.array(cam_from_obj), self.model.diameter
        center = np.ascontiguousarray(self.model.centroid)
        steps = np.linspace(*reach, ITERATIONS) * size
        observed = np.concatenate([depth[..., None], normals], -1)
        icp(moved, self.points - center, self.normals, center, observed, intrinsics, steps, size)
        moved[:, :3, :3] = poses.nearest_rotation(moved[:, :3, :3])
        return moved
