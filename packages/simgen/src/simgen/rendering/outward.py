"""Whether a mesh's back faces are never seen, so that they need not be drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def faces_outward(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    """Whether every component is closed and consistently wound, normals out, so that back faces are never seen."""
    _, merged = np.unique(vertices, axis=0, return_inverse=True)
    merged = merged.reshape(-1)[faces].astype(np.int64)
    edges = np.concatenate([merged[:, [0, 1]], merged[:, [1, 2]], merged[:, [2, 0]]])
    forward, backward = edges @ [len(vertices), 1], edges @ [1, len(vertices)]
    once = np.unique(forward)
    if len(once) != len(forward) or not np.array_equal(once, np.sort(backward)):
        return False
    graph = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    _, component = connected_components(graph, directed=False)
    volume = np.linalg.det(vertices[faces] - vertices.mean(0))
    return bool((np.bincount(component[merged[:, 0]], volume)[np.unique(component[merged[:, 0]])] > 0).all())
