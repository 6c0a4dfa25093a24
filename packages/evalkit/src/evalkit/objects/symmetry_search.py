"""From a surface's moments to hypotheses of its symmetry group, each refined and verified.

Axes are sought where the moments allow them: a turn of order 3 or more needs two equal moments, so with three
different ones only half turns about the principal axes are possible; with two equal ones every fold about the third
axis and half turns across it; with three equal ones every direction is tried.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes
from evalkit.objects.sight import Sight
from evalkit.objects.surface import Surface
from evalkit.objects.symmetry import Symmetry
from evalkit.objects.symmetry_fit import (
    DENSE,
    SymmetryCandidate,
    about,
    deviation,
    hemisphere,
    judged,
    refine,
    same_axis,
    scan,
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
GLANCES = 2  # views that rank hypotheses which distances do not tell apart


def group_size(symmetry: Symmetry) -> float:
    """The group's size, the continuous ones above all finite ones."""
    return len(symmetry.rotations) * {"finite": 1.0, "revolution": 1e6, "sphere": 1e9}[symmetry.kind]


class SymmetrySearch:
    """From a surface's moments to its group; `tried` keeps every hypothesis that was refined and verified."""

    def __init__(self, surface: Surface, sight: Sight) -> None:
        self.surface, self.sight = surface, sight
        self.tried: list[SymmetryCandidate] = []
        self.witnesses = surface.points[:WITNESSES]

    def run(self) -> list[SymmetryCandidate]:
        """All that was tried; the largest of the accepted groups is the answer."""
        moments, axes = principal_axes(self.surface.covariance)
        below, above = np.diff(moments) / moments[-1]
        if below + above < EQUAL_MOMENTS:
            self._any_axis(axes)
        elif min(below, above) < EQUAL_MOMENTS:
            self._one_axis(np.roll(axes, 0 if below < above else -1, axis=1))
        else:
            self._principal_axes(axes)
        return self.tried

    def _principal_axes(self, axes: Array) -> None:
        """Three different moments: half turns about their axes, or about all three."""
        half_turns = [self._test(about("cyclic:2", axis)) for axis in axes.T]
        if all(half_turn.accepted for half_turn in half_turns):
            self._test(Symmetry.parse("dihedral:2", axes))

    def _one_axis(self, axes: Array) -> None:
        """Two equal moments: any fold about the third one's axis (axes[:, 2]), half turns across it."""
        spin = self._largest_about(axes[:, 2], range(2, MAX_FOLD + 1))
        if spin is not None:
            self._with_flip(spin)
            return
        likely = scan(self.surface, "cyclic:2", _circle(axes[:, 2]), most=4)
        turns = [self._test(half_turn) for half_turn in (*(about("cyclic:2", axis) for axis in axes.T[:2]), *likely)]
        if any(turn.only_seen_to_be_wrong for turn in turns) and not any(turn.accepted for turn in turns):
            self._first_in_sight([about("cyclic:2", axis) for axis in _circle(axes[:, 2])])

    def _any_axis(self, axes: Array) -> None:
        """Three equal moments: a ball, a polyhedron's group, or one main axis in any direction."""
        ball = self._test(Symmetry.parse("sphere"))
        if ball.accepted:
            return
        for axis in axes.T:  # what marks a ball moves its principal axes, however small it is
            turn = self._test(about("revolution", axis))
            if turn.accepted:
                self._with_flip(turn.symmetry)
                return
        if ball.only_seen_to_be_wrong:
            for spin in filter(None, (self._largest_about(axis, range(2, MAX_FOLD + 1)) for axis in axes.T)):
                self._with_flip(spin)
            return
        spins: list[Symmetry] = []
        for prime in PRIMES:
            spins += self._spins_of(prime, spins)
            if prime == 3 and len(spins) > 1 and self._polyhedral(spins[0].axis, spins[1].axis):
                return
            if spins and spins[-1].kind == "revolution":
                break
        if spins:
            self._with_flip(max(spins, key=group_size))

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
        self._remember_witnesses(about("revolution", axis), self.surface.points[: 3 * QUICK])
        promises = self._promises(axis, folds)
        likely = sorted((excess > 1.0, -fold) for fold, excess in promises.items())
        left = [-negative for _, negative in likely] or list(folds[:1])
        if revolution.only_seen_to_be_wrong:
            left = self._in_sight(axis, left)
        left = left[:MOST_FOLDS]
        while left:
            spin = self._test(about(f"cyclic:{left.pop(0)}", axis))
            if spin.accepted:
                return spin.symmetry
            if spin.only_seen_to_be_wrong:
                left = self._in_sight(axis, left)
        return None

    def _promises(self, axis: Array, folds: range) -> dict[int, float]:
        """The excess of those of the ascending `folds` about `axis` that are worth refining.

        A group holds the groups of its order's divisors, so that most folds are ruled out by a smaller one.
        """
        promises: dict[int, float] = {}
        hopeless: list[int] = []
        for fold in folds:
            if not any(fold % divisor == 0 for divisor in hopeless):
                promises[fold] = self._promise(about(f"cyclic:{fold}", axis))
                if promises[fold] > MARGIN:
                    hopeless.append(fold)
        return {fold: excess for fold, excess in promises.items() if excess <= MARGIN}

    def _in_sight(self, axis: Array, folds: list[int]) -> list[int]:
        """Those of the folds that look right where the last hypothesis was seen to be wrong."""
        return [fold for fold in folds if self.sight.at_a_glance(about(f"cyclic:{fold}", axis)) <= 1.0]

    def _first_in_sight(self, hypotheses: list[Symmetry]) -> None:
        """Test those that look best, where distances do not tell the hypotheses apart."""
        glances = [self.sight.at_a_glance(symmetry, GLANCES) for symmetry in hypotheses]
        for best in np.argsort(glances, kind="stable")[:3]:
            if self._test(hypotheses[best]).accepted:
                return

    def _with_flip(self, spin: Symmetry) -> None:
        """The group with half turns across the axis of `spin` too, where the surface has them."""
        if spin.kind == "revolution":
            self._test(Symmetry.parse("revolution-flip", spin.obj_from_sym))
            return
        fold = len(spin.rotations)
        steps = max(24, 120 // fold)
        turns = poses.from_axis_angle([0.0, 0.0, 1.0], np.arange(steps) * (np.pi / fold / steps))
        flipped = [Symmetry.parse(f"dihedral:{fold}", poses.compose(spin.obj_from_sym, turn)) for turn in turns]
        scores = np.array([self._verify(symmetry, 400).typical_excess for symmetry in flipped])
        for best in np.argsort(scores)[:3]:
            candidate = self._test(flipped[best])
            if candidate.accepted:
                return
            if candidate.only_seen_to_be_wrong:
                self._first_in_sight([flipped[i] for i in np.flatnonzero(scores <= MARGIN)])
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
            points = self.surface.points[:DENSE]
            distance, relative = deviation(self.surface, refined, points)
            candidate = judged(self.surface, refined, distance, relative)
            if candidate.accepted:
                candidate = replace(candidate, sight_excess=self.sight.excess(refined))
            else:
                self._keep_witnesses(points, relative)
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

    def _remember_witnesses(self, refuted: Symmetry, points: Array) -> None:
        """Keep those of the points (n, 3) that land farthest off the surface once turned."""
        self._keep_witnesses(points, deviation(self.surface, refuted, points)[1])

    def _keep_witnesses(self, points: Array, relative: Array) -> None:
        farthest = points[np.argsort(-relative)[:WITNESSES]]
        self.witnesses = np.concatenate([farthest, self.witnesses])[: 4 * WITNESSES]


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
