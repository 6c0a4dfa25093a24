"""Which faces of a mesh can be seen from outside, and which lie within: inner bodies, cavities, faces in contact.

CAD files hold what is inside a housing, and no camera ever sees it. It must not move the centroid, the diameter or the
symmetry that labels and scores rest on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.geometry import poses
from evalkit.objects.depth_views import DepthViews, sphere_directions

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
SIDE = 256  # pixels of a view across the bounding box's diagonal: a wall of 0.3 % of it hides what is behind
LINES = 48  # of sight, each looked along from both ends
LEAST_SEEN = 1e-3  # share of a face's samples and views: less are pixels that the outline only half covers
FACING = 0.7  # cosine between face and view from which on a sample counts that is not its pixel's very nearest
CREVICES = 0.01  # of the area: less than this, of bodies that are seen, is no hidden surface but cracks between views
CELLS = 1 << 20  # of the size, to weld: 1e-6


def seen_from_outside(vertices: ArrayLike, faces: ArrayLike) -> Mask:
    """Mask (F,) of the faces that some camera outside may see: vertices (V, 3), faces (F, 3).

    A single body whose every edge has at most two faces hides nothing from view but its own crevices, and is kept
    whole at no cost.
    """
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    everything = np.ones(len(faces), bool)
    if len(faces) == 0:
        return everything
    low, high = vertices[np.unique(faces)].min(0), vertices[np.unique(faces)].max(0)
    body, crowded = _bodies((vertices - low) / (float((high - low).max()) or 1.0), faces)
    if body.max() == 0 and not crowded:
        return everything
    radius = float(np.linalg.norm(high - low)) / 2
    seen = _seen((vertices - (low + high) / 2) / radius, faces)
    hidden_bodies = np.bincount(body, seen) == 0
    areas = _areas(vertices, faces)
    unseen = ~seen & ~hidden_bodies[body]
    if areas[unseen].sum() < CREVICES * areas.sum():
        seen |= unseen
    return seen if seen.any() else everything


def _seen(vertices: Array, faces: NDArray[np.integer]) -> Mask:
    """Faces that are in front in many views; vertices within the unit ball.

    Samples on a face's sides do not vote, for they lie on its neighbors too; a face below a pixel has no others.
    """
    views = DepthViews(vertices, faces, SIDE)
    has_inner = np.bincount(views.face, views.inner, len(faces)) > 0
    voters = np.flatnonzero(views.inner | ~has_inner[views.face])
    face = views.face[voters]
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    votes = np.zeros(len(faces), np.int64)
    for cam_from_obj in poses.rotation_between(sphere_directions(2 * LINES)[:LINES], [0.0, 0.0, 1.0]):
        pixel, depth = views.project(cam_from_obj)
        along, against = views.nearest(pixel, depth)
        pixel, depth = pixel[voters], depth[voters]
        cosine = np.abs((normals * cam_from_obj[2]).sum(1))
        slope = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, FACING)
        behind = np.where(cosine > FACING, 2.0 / SIDE * slope, 0.0)  # a slanted face's own span within a pixel
        for in_front in (depth - along[pixel] <= behind[face], -depth - against[pixel] <= behind[face]):
            votes += np.bincount(face[in_front], minlength=len(faces))
    return np.asarray(votes > LEAST_SEEN * 2 * LINES * np.bincount(face, minlength=len(faces)))


def _bodies(vertices: Array, faces: NDArray[np.integer]) -> tuple[NDArray[np.int64], bool]:
    """The connected body (F,) of each face, counted from 0, and whether some edge has more than two faces.

    Vertices of the unit cube at one place count as one: STL files repeat each for every face.
    """
    from scipy.sparse import coo_matrix  # slow to import, and scoring needs none of this
    from scipy.sparse.csgraph import connected_components

    cells = np.clip(np.rint(vertices * (CELLS - 1)), 0, CELLS - 1).astype(np.int64)
    _, welded = np.unique((cells[:, 0] * CELLS + cells[:, 1]) * CELLS + cells[:, 2], return_inverse=True)
    welded_faces = welded.reshape(-1)[faces]
    edges = np.sort(np.concatenate([welded_faces[:, [0, 1]], welded_faces[:, [1, 2]], welded_faces[:, [2, 0]]]), axis=1)
    count = len(vertices)
    proper = edges[edges[:, 0] != edges[:, 1]]
    _, faces_of_edge = np.unique(proper[:, 0] * count + proper[:, 1], return_counts=True)
    graph = coo_matrix((np.ones(len(edges), bool), edges.T), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    _, body = np.unique(label[welded_faces[:, 0]], return_inverse=True)
    return body.reshape(-1), bool((faces_of_edge > 2).any())


def _areas(vertices: Array, faces: NDArray[np.integer]) -> Array:
    corners = vertices[faces]
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))
