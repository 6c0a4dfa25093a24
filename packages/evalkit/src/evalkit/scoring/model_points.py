"""The points that ADD, ADD-S, MSSD and MSPD run over: the mesh's vertices, as those who proposed them have it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]


def model_points(model: ObjectModel, criterion: str) -> Array:
    """The mesh's vertices (n, 3) where they are known, else the sample of the surface.

    Raises:
        InputError: the model has neither, which `criterion` needs.
    """
    points = model.points if model.vertices is None else model.finite_vertices
    if points is None or len(points) == 0:
        raise InputError(
            f"object '{model.title}' carries neither 'vertices' nor 'points', which --criterion {criterion} needs; "
            "write gt.json from shards or with the mesh at hand, or use --criterion sym."
        )
    return points


def describe_points(model: ObjectModel) -> str:
    """Which points they are, for the reader of a score."""
    if model.vertices is not None:
        return f"over the mesh's {len(model.finite_vertices)} vertices"
    count = 0 if model.points is None else len(model.points)
    return f"over a sample of {count} points of the surface, not the mesh's vertices, which the ground truth lacks"
