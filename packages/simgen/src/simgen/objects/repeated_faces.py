"""Faces that a mesh holds more than once: copies, and the two sides of a contact between bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Faces = NDArray[np.int64]
THIN = 1e-5  # height over longest side of a triangle that nobody sees


class SingleFaces(NamedTuple):
    """Faces (F, 3) of which no two have the same corners, how many copies were dropped, and how many of contacts."""

    faces: Faces
    copies: int
    in_contact: int


def without_repeated_faces(vertices: NDArray[np.float64], faces: Faces) -> SingleFaces:
    """Of faces on the same corners the first, and of those where two bodies touch none.

    Where two bodies touch, each has a face on the same corners, wound against the other's. Both lie within the solid
    that the bodies make together, so dropping both leaves that solid. A sheet drawn from both sides looks the same but
    has a rim where it ends; its faces stay, once each.

    Faces of no area with three distinct corners stay, for they hold closed meshes together; but not where two of them
    lie on each other, between neighbors that both have corners on their common side.
    """
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if len(faces) == 0:
        return SingleFaces(faces, 0, 0)
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    new = np.ones(len(faces), bool)
    new[1:] = (np.diff(corners[order], axis=0) != 0).any(1)
    first, group = order[new], np.empty(len(faces), np.int64)
    group[order] = np.cumsum(new) - 1
    one_way, uses = np.bincount(group, _is_even(faces)), np.bincount(group)
    twins = (one_way > 0) & (one_way < uses)
    contact = np.zeros(len(first), bool)
    if twins.any():
        doubled = faces[first[twins]]
        contact[twins] = _between_bodies(doubled, faces[first[~twins]]) | _thin(vertices[doubled])
    pairs = int(contact.sum())
    return SingleFaces(faces[np.sort(first[~contact])], len(faces) - len(first) - pairs, 2 * pairs)


def _is_even(faces: Faces) -> NDArray[np.bool_]:
    """Whether the corners (F, 3) run the way in which their sorted order does."""
    a, b, c = faces.T
    return np.asarray((a < b).astype(int) + (b < c) + (c < a) == 2)


def _thin(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which triangles (F, 3, 3) have next to no height."""
    sides = np.roll(corners, -1, 1) - corners
    longest = (sides**2).sum(-1).max(1)
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= THIN * longest)


def _between_bodies(twins: Faces, others: Faces) -> NDArray[np.bool_]:
    """Which of the faces (T, 3) that are there from both sides lie where two bodies touch.

    Those of a connected patch that has a rim, along all of which other faces of both bodies go on: two at each edge.
    """
    edges, ends = _edge_numbers(np.concatenate([twins, others]))
    own, theirs = edges[: len(twins)], edges[len(twins) :]
    own_uses, other_uses = (np.bincount(some.reshape(-1), minlength=ends) for some in (own, theirs))
    face = np.repeat(np.arange(len(twins)), 3)
    graph = coo_matrix((np.ones(len(face), bool), (face, len(twins) + own.reshape(-1))), shape=(len(twins) + ends,) * 2)
    _, patch = connected_components(graph, directed=False)
    rim, goes_on = own_uses == 1, other_uses == 2
    patch_of_edge = patch[len(twins) :]
    has_rim, ends_free = np.zeros(patch.max() + 1, bool), np.zeros(patch.max() + 1, bool)
    has_rim[patch_of_edge[rim]] = True
    ends_free[patch_of_edge[rim & ~goes_on]] = True
    return np.asarray((has_rim & ~ends_free)[patch[: len(twins)]])


def _edge_numbers(faces: Faces) -> tuple[Faces, int]:
    """The number (F, 3) of each face's undirected edges, counted from 0, and how many there are."""
    directed = np.stack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]], 1)
    ends = np.sort(directed, axis=2).reshape(-1, 2)
    different, number = np.unique(ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1], return_inverse=True)
    return number.reshape(-1, 3), len(different)
