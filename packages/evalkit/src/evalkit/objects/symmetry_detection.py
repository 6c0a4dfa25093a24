"""Find the proper symmetry group of a mesh, about its area centroid, and how well the mesh keeps to it.

Axes are sought where the moments allow them: a turn of order 3 or more needs two equal moments, so with three
different ones only half turns about the principal axes are possible; with two equal ones every fold about the third
axis and half turns across it; with three equal ones every direction is tried. Each hypothesis is refined and then
verified on a dense sample of the surface (:mod:`evalkit.objects.symmetry_fit`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.surface import Surface
from evalkit.objects.symmetry import SYNTAX, Symmetry
from evalkit.objects.symmetry_fit import (
    DENSE,
    SymmetryCandidate,
    about,
    deviation,
    fit,
    hemisphere,
    refine,
    same_axis,
    scan,
    snapped,
    verify,
)

Array = NDArray[np.float64]

EQUAL_MOMENTS = 0.05  # relative difference below which two moments may be equal
MAX_FOLD = 120  # finer teeth than this are shallower than the tolerance: a revolution
PRIMES = (3, 2, 5, 7)  # orders tried where any direction may be an axis
QUICK = 3000  # surface points of a first verification
MARGIN = 1.5  # what may exceed the tolerances at first, before refinement and the dense verification
WITNESSES = 200  # points that refuted a hypothesis, kept to refute the next
MOST_FOLDS = 12  # folds that are verified densely about one axis


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
    surface = Surface.from_mesh(vertices, faces)
    tried = _Search(surface).run()
    accepted = [candidate for candidate in tried if candidate.accepted]
    if not accepted:
        return DetectedSymmetry(Symmetry.parse("none"), 0.0, 0.0, _best_of_each_name(tried))
    chosen = snapped(surface, max(accepted, key=lambda candidate: _order(candidate.symmetry)))
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
    surface = Surface.from_mesh(vertices, faces)
    chosen = fit(surface, symmetry.name, axis)
    chosen = snapped(surface, chosen) if axis is None else chosen
    return _detected(chosen, [chosen], surface)


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


def _order(symmetry: Symmetry) -> float:
    """The group's size, the continuous ones above all finite ones."""
    return len(symmetry.rotations) * {"finite": 1.0, "revolution": 1e6, "sphere": 1e9}[symmetry.kind]


class _Search:
    """From a surface's moments to its group; `tried` keeps every hypothesis that was refined and verified."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.tried: list[SymmetryCandidate] = []
        self.witnesses = surface.points[:WITNESSES]

    def run(self) -> list[SymmetryCandidate]:
        """All that was tried; the largest of the accepted groups is the answer."""
        moments, axes = np.linalg.eigh(self.surface.covariance)
        below, above = np.diff(moments) / moments[-1]
        if below + above < EQUAL_MOMENTS:
            self._any_axis()
        elif min(below, above) < EQUAL_MOMENTS:
            self._one_axis(axes[:, 2 if below < above else 0])
        else:
            self._principal_axes(axes)
        return self.tried

    def _principal_axes(self, axes: Array) -> None:
        """Three different moments: half turns about their axes, or about all three."""
        half_turns = [self._test(about("cyclic:2", axis)) for axis in axes.T]
        if all(half_turn.accepted for half_turn in half_turns):
            self._test(Symmetry.parse("dihedral:2", axes * np.sign(np.linalg.det(axes))))

    def _one_axis(self, axis: Array) -> None:
        """Two equal moments: any fold about the third one's axis, half turns across it."""
        spin = self._largest_about(axis, range(2, MAX_FOLD + 1))
        if spin is not None:
            self._with_flip(spin)
            return
        for half_turn in scan(self.surface, "cyclic:2", _circle(axis), most=4):
            self._test(half_turn)

    def _any_axis(self) -> None:
        """Three equal moments: a ball, a polyhedron's group, or one main axis in any direction."""
        if self._test(Symmetry.parse("sphere")).accepted:
            return
        spins: list[Symmetry] = []
        for prime in PRIMES:
            spins += self._spins_of(prime, spins)
            if prime == 3 and len(spins) > 1 and self._polyhedral(spins[0].axis, spins[1].axis):
                return
            if spins and spins[-1].kind == "revolution":
                break
        if spins:
            self._with_flip(max(spins, key=_order))

    def _spins_of(self, prime: int, known: Iterable[Symmetry]) -> list[Symmetry]:
        """Groups about one axis each, of an order that `prime` divides, beside the `known` axes; two at most."""
        found: list[Symmetry] = []
        for guess in scan(self.surface, f"cyclic:{prime}", hemisphere(2500)):
            turn = self._test(guess)
            if not turn.accepted or any(same_axis(turn.symmetry.axis, s.axis) for s in (*known, *found)):
                continue
            found.append(self._largest_about(turn.symmetry.axis, range(prime, MAX_FOLD + 1, prime)) or turn.symmetry)
            if len(found) == 2 or found[0].kind == "revolution":
                break
        return found

    def _largest_about(self, axis: Array, folds: range) -> Symmetry | None:
        """The revolution about `axis` if the surface is one, else its highest fold of `folds`."""
        revolution = self._test(about("revolution", axis))
        if revolution.accepted:
            return revolution.symmetry
        self._remember_witnesses(about("revolution", axis))
        promises = {fold: self._promise(about(f"cyclic:{fold}", axis)) for fold in folds}
        likely = sorted((promises[fold] > 1.0, -fold) for fold in folds if promises[fold] <= MARGIN)
        for fold in [-negative for _, negative in likely[:MOST_FOLDS]] or folds[:1]:
            spin = self._test(about(f"cyclic:{fold}", axis))
            if spin.accepted:
                return spin.symmetry
        return None

    def _with_flip(self, spin: Symmetry) -> None:
        """The group with half turns across the axis of `spin` too, where the surface has them."""
        if spin.kind == "revolution":
            self._test(Symmetry.parse("revolution-flip", spin.obj_from_sym))
            return
        fold = len(spin.rotations)
        steps = max(24, 120 // fold)
        turns = poses.from_axis_angle([0.0, 0.0, 1.0], np.arange(steps) * (np.pi / fold / steps))
        flipped = [Symmetry.parse(f"dihedral:{fold}", spin.obj_from_sym @ turn) for turn in turns]
        scores = [self._verify(symmetry, 400).typical for symmetry in flipped]
        for best in np.argsort(scores)[:3]:
            if self._test(flipped[best]).accepted:
                return

    def _polyhedral(self, first: Array, second: Array) -> bool:
        """Whether two three-fold axes belong to a polyhedron's group."""
        for name in ("icosahedral", "octahedral", "tetrahedral"):
            likely = [Symmetry.parse(name, frame) for frame in _frames_through(name, first, second)]
            likely.sort(key=lambda symmetry: self._verify(symmetry, QUICK).typical)
            if likely and self._test(likely[0]).accepted:
                return True
        return False

    def _test(self, symmetry: Symmetry) -> SymmetryCandidate:
        """Refine, verify, and keep as evidence."""
        refined = refine(self.surface, symmetry)
        candidate = self._verify(refined, QUICK)
        telling = self._on_witnesses(refined)
        if telling.worst_excess > max(1.0, candidate.worst_excess):
            candidate = replace(candidate, worst=telling.worst, worst_excess=telling.worst_excess)
        elif candidate.excess <= MARGIN:
            candidate = self._verify(refined, DENSE)
            if not candidate.accepted:
                self._remember_witnesses(refined)
        self.tried.append(candidate)
        return candidate

    def _verify(self, symmetry: Symmetry, count: int) -> SymmetryCandidate:
        return verify(self.surface, symmetry, self.surface.points[:count])

    def _on_witnesses(self, symmetry: Symmetry) -> SymmetryCandidate:
        return verify(self.surface, symmetry, self.witnesses)

    def _promise(self, symmetry: Symmetry) -> float:
        """The excess of an unrefined hypothesis, by a few points; it is worth refining up to MARGIN."""
        excess = self._on_witnesses(symmetry).worst_excess
        return excess if excess > MARGIN else max(excess, self._verify(symmetry, QUICK).excess)

    def _remember_witnesses(self, refuted: Symmetry) -> None:
        """Keep the points that land farthest off the surface once turned."""
        points = self.surface.points[:DENSE]
        _, relative = deviation(self.surface, refuted, points)
        self.witnesses = np.concatenate([points[np.argsort(-relative)[:WITNESSES]], self.witnesses])[: 4 * WITNESSES]


def _circle(axis: Array) -> Array:
    """Directions (n, 3) across `axis`, 1.5 degrees apart over half a turn."""
    across = poses.rotation_between([0.0, 0.0, 1.0], axis)[:, 0]
    return poses.from_axis_angle(axis, np.arange(120) * (np.pi / 120)) @ across


def _frames_through(name: str, first: Array, second: Array) -> list[Array]:
    """Frames (3, 3) of a polyhedral group that put two of its three-fold axes along the given ones."""
    rotations = Symmetry.parse(name).rotations
    thirds = rotations[np.abs(np.trace(rotations, axis1=1, axis2=2)) < 1e-6]
    axes = np.stack([thirds[:, i, j] - thirds[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], -1) / np.sqrt(3.0)
    partners = [other for other in axes[1:] if abs(float(axes[0] @ other - first @ second)) < 0.1]
    return [_frame_of(first, second) @ _frame_of(axes[0], partner).T for partner in partners]


def _frame_of(a: Array, b: Array) -> Array:
    """An orthonormal frame (3, 3) with columns: a, what b has across a, and their normal."""
    across = b - (a @ b) * a
    across /= np.linalg.norm(across)
    return np.stack([a, across, np.cross(a, across)], -1)
