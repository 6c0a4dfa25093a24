"""Find the proper symmetry group of a mesh, about its area centroid, and how well the mesh keeps to it.

Hypotheses (:mod:`evalkit.objects.symmetry_search`) are refined and then verified, by distances on a dense sample of the
surface (:mod:`evalkit.objects.symmetry_fit`) and by what a camera sees (:mod:`evalkit.objects.sight`). Surfaces that
cannot be seen from outside have no say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError
from evalkit.objects.outside import seen_from_outside
from evalkit.objects.sight import Sight
from evalkit.objects.surface import Surface
from evalkit.objects.symmetry import SYNTAX, Symmetry
from evalkit.objects.symmetry_fit import SymmetryCandidate, fit, snapped
from evalkit.objects.symmetry_search import SymmetrySearch, group_size

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DetectedSymmetry:
    """A symmetry and what speaks for it.

    Attributes:
        residual: meters; 99 of 100 surface points land within it of the surface, once turned by the group.
        relative_residual: the same over the diameter.
        candidates: the best hypothesis of every name that was tried, by excess; empty for a symmetry of `none` given.
    """

    symmetry: Symmetry
    residual: float
    relative_residual: float
    candidates: list[SymmetryCandidate]

    @property
    def evidence(self) -> SymmetryCandidate | None:
        """The candidate that was chosen; None when that is no symmetry at all."""
        return next((c for c in self.candidates if c.symmetry is self.symmetry), None)

    @property
    def runner_up(self) -> SymmetryCandidate | None:
        """The nearest of the hypotheses that were turned down."""
        return next((c for c in self.candidates if not c.accepted), None)


def detect_symmetry(vertices: ArrayLike, faces: ArrayLike) -> DetectedSymmetry:
    """The largest proper symmetry group that the surface keeps to: vertices (V, 3) in meters, faces (F, 3)."""
    surface, sight = _looked_at(vertices, faces)
    tried = SymmetrySearch(surface, sight).run()
    accepted = [candidate for candidate in tried if candidate.accepted]
    if not accepted:
        return DetectedSymmetry(Symmetry.parse("none"), 0.0, 0.0, _best_of_each_name(tried))
    chosen = snapped(surface, max(accepted, key=lambda candidate: group_size(candidate.symmetry)))
    others = [candidate for candidate in tried if candidate.symmetry.name != chosen.symmetry.name]
    return _detected(chosen, [chosen, *_best_of_each_name(others)], surface)


def resolve_symmetry(vertices: ArrayLike, faces: ArrayLike, spec: str) -> DetectedSymmetry:
    """What a user asked for: ``auto``, a group's name, or a name and its main axis such as ``revolution@z``.

    The axis is x, y, z or three numbers (``cyclic:4@0,1,1``) in the object's frame; without one the group is placed
    where it fits best.

    Raises:
        InputError: `spec` is none of these.
    """
    if spec == "auto":
        return detect_symmetry(vertices, faces)
    name, at, direction = spec.partition("@")
    symmetry = Symmetry.parse(name)
    axis = _parse_axis(direction, spec) if at else None
    if symmetry.name == "none":
        return DetectedSymmetry(symmetry, 0.0, 0.0, [])
    surface, sight = _looked_at(vertices, faces)
    chosen = fit(surface, symmetry.name, axis)
    chosen = snapped(surface, chosen) if axis is None else chosen
    chosen = replace(chosen, sight_excess=sight.excess(chosen.symmetry))
    return _detected(chosen, [chosen], surface)


def _looked_at(vertices: ArrayLike, faces: ArrayLike) -> tuple[Surface, Sight]:
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    faces = faces[seen_from_outside(vertices, faces)]
    surface = Surface.from_mesh(vertices, faces)
    return surface, Sight(vertices, faces, surface)


def _parse_axis(text: str, spec: str) -> Array:
    named = dict(zip("xyz", np.eye(3), strict=True))
    if text in named:
        return named[text]
    try:
        axis = np.array([float(part) for part in text.split(",")])
    except ValueError:
        axis = np.zeros(0)
    if axis.shape != (3,) or not np.isfinite(axis).all() or not np.linalg.norm(axis) > 0:
        raise InputError(f"symmetry '{spec}': after '@' comes x, y, z or three numbers; before it {SYNTAX}.")
    return axis / np.linalg.norm(axis)


def _detected(chosen: SymmetryCandidate, candidates: list[SymmetryCandidate], surface: Surface) -> DetectedSymmetry:
    return DetectedSymmetry(chosen.symmetry, chosen.typical, chosen.typical / (2 * surface.radius), candidates)


def _best_of_each_name(candidates: list[SymmetryCandidate]) -> list[SymmetryCandidate]:
    best: dict[str, SymmetryCandidate] = {}
    for candidate in sorted(candidates, key=lambda c: c.excess):
        best.setdefault(candidate.symmetry.name, candidate)
    return list(best.values())
