"""Faces wound counter-clockwise seen from outside, decided for each closed body on its own."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]
PROBES = 8  # vertices of a body that are asked whether they lie in another; most of them decide


class Winding(NamedTuple):
    """Faces (F, 3) wound outwards, and what had to be turned for that."""

    faces: Faces
    were_alike: bool  # neighbors agreed from the start
    are_alike: bool  # they agree now; a Moebius strip's never do
    bodies: int  # closed ones, cavities among them
    cavities: int
    turned_bodies: int  # of those, how many were inside out
    turned_rest: bool  # the open surfaces were inside out, taken together


def wound_outwards(vertices: Vertices, faces: Faces) -> Winding:
    """Wind neighboring faces alike, and every closed body outwards; true cavities stay wound inwards.

    A body inside a body that is wound against it is its cavity; a body in empty space is never one. Open surfaces have
    no inside, so all of them together decide, as if they were one body with holes.
    """
    pairs, opposed, closed = _neighbors(faces)
    flip, twisted = _flips_for_agreement(len(faces), pairs, opposed)
    faces = np.where(flip[:, None], faces[:, ::-1], faces)
    count, body = _bodies(len(faces), pairs)
    is_closed = np.ones(count, bool)
    np.logical_and.at(is_closed, body, closed & ~twisted)
    chosen = _split(body, is_closed)
    signs = _outward_signs(vertices, [faces[own] for own in chosen])
    turn = np.zeros(len(faces), bool)
    for own, sign in zip(chosen, signs, strict=True):
        turn[own] = sign < 0
    rest = ~is_closed[body]
    turn_rest = bool(rest.any()) and signed_volume(vertices, faces[rest]) < 0
    turn[rest] = turn_rest
    turned = np.where(turn[:, None], faces[:, ::-1], faces)
    return Winding(
        turned,
        were_alike=not opposed.any(),
        are_alike=not twisted.any(),
        bodies=len(chosen),
        cavities=sum(signed_volume(vertices, turned[own]) < 0 for own in chosen),
        turned_bodies=sum(sign < 0 for sign in signs),
        turned_rest=turn_rest,
    )


def signed_volume(vertices: Vertices, faces: NDArray[np.integer[Any]]) -> float:
    """Signed volume under the faces, seen from the middle of their vertices."""
    if len(faces) == 0:
        return 0.0
    a, b, c = np.moveaxis((vertices - vertices[np.unique(faces)].mean(0))[faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def _neighbors(faces: Faces) -> tuple[Faces, NDArray[np.bool_], NDArray[np.bool_]]:
    """Pairs of faces (N, 2) that alone share an edge, whether they run along it in one direction (N,), which they
    must not, and whether all edges of a face are shared by two faces (F,)."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    ends = np.sort(directed, axis=1)
    order = np.lexsort(ends.T)
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(ends[order], axis=0) != 0).any(1)
    start = np.flatnonzero(first)
    uses = np.diff(np.append(start, len(order)))
    a, b = order[start[uses == 2]], order[start[uses == 2] + 1]
    closed = np.ones(len(faces), bool)
    closed[owner[order[np.repeat(uses != 2, uses)]]] = False
    return np.stack([owner[a], owner[b]], -1), directed[a, 0] == directed[b, 0], closed


def _flips_for_agreement(
    count: int, pairs: Faces, opposed: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which faces (F,) to turn so that neighbors agree, and which (F,) lie on a surface with one side only.

    Every face stands twice in a graph, as it is and turned; edges lead to the state in which a neighbor agrees. Of the
    two halves into which a body's states fall, the one that turns fewer faces is chosen.
    """
    f, g = pairs.T
    links = np.concatenate([np.stack([f, g + count * opposed]), np.stack([f + count, g + count * ~opposed])], axis=1)
    graph = coo_matrix((np.ones(links.shape[1], np.int8), links), shape=(2 * count, 2 * count))
    _, label = connected_components(graph, directed=False)
    kept, turned = label[:count], label[count:]
    left_as_they_are = np.bincount(kept, minlength=label.max(initial=-1) + 1)
    fewer = left_as_they_are[turned] > left_as_they_are[kept]
    tie = (left_as_they_are[turned] == left_as_they_are[kept]) & (turned < kept)
    twisted = kept == turned
    return (fewer | tie) & ~twisted, twisted


def _bodies(count: int, pairs: Faces) -> tuple[int, NDArray[np.int64]]:
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(count, count))
    found, body = connected_components(graph, directed=False)
    return int(found), body.astype(np.int64)


def _split(body: NDArray[np.int64], is_closed: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """The faces of each closed body."""
    order = np.argsort(body, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(body))[:-1])
    return [groups[i] for i in np.flatnonzero(is_closed)]


def _outward_signs(vertices: Vertices, bodies: list[Faces]) -> list[int]:
    """1 for every closed body whose faces are to stay as they are, -1 for those to be turned."""
    volumes = np.array([signed_volume(vertices, faces) for faces in bodies])
    lows = np.array([vertices[faces].min((0, 1)) for faces in bodies]).reshape(-1, 3)
    highs = np.array([vertices[faces].max((0, 1)) for faces in bodies]).reshape(-1, 3)
    stay = [1] * len(bodies)
    sizes = np.abs(volumes)
    for i in np.argsort(-sizes):  # what contains another is larger
        candidates = (lows <= lows[i]).all(1) & (highs >= highs[i]).all(1) & (sizes > sizes[i])
        around = [j for j in np.flatnonzero(candidates) if _contains(vertices, bodies[j], bodies[i])]
        stay[i] = 1 if volumes[i] >= 0 else -1
        if around:
            parent = min(around, key=sizes.__getitem__)
            parent_is_solid = volumes[parent] * stay[parent] > 0
            if parent_is_solid:  # wound against it: its cavity; wound alike: a body within it
                stay[i] = stay[parent]
    return stay


def _contains(vertices: Vertices, outer: Faces, inner: Faces) -> bool:
    """Whether most vertices of the closed body `inner` lie inside the closed body `outer` (by winding number)."""
    used = np.unique(inner)
    probes = vertices[used[np.linspace(0, len(used) - 1, min(PROBES, len(used))).astype(int)]]
    return bool(np.median([abs(_winding_number(vertices[outer] - probe)) for probe in probes]) > 0.75)


def _winding_number(corners: NDArray[np.float64]) -> float:
    """How often triangles (F, 3, 3) go around the origin (van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    above = np.einsum("fi,fi->f", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(np.arctan2(above, below).sum() / (2 * np.pi))
