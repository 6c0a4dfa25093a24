"""How well a surface keeps to a symmetry group, and where the group fits best: verify, refine, scan.

Points are in units of the surface's bounding radius about its centroid (:class:`evalkit.objects.surface.Surface`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes
from evalkit.geometry.small_systems import solve_positive
from evalkit.objects.depth_views import sphere_directions
from evalkit.objects.surface import Surface
from evalkit.objects.symmetry import Symmetry

Array = NDArray[np.float64]

TYPICAL_TOLERANCE = 0.024  # of the lever: 99 of 100 turned points are nearer to the surface than this
WORST_TOLERANCE = 0.036  # and all but a handful nearer than this: 1.8 % of a round object's diameter
NOISE_LEVERS = 300.0  # lever that noise asks for, in roughnesses: a noise of 0.35 % of the diameter asks for one
MOST_STRETCHED = 1.5  # what noise may stretch a tolerance by: a feature of 3 % of the diameter is no noise
HANDFUL = 6  # samples that may deviate more: near-misses of the sampled surface
DENSE = 24_000  # surface points of a final verification
ROUGHLY = 4000  # surface points that tell how thick a part is
ROUGH_LIMIT = 0.12  # mean rough distance beyond which a direction is not worth refining
SNAP_ANGLE = np.radians(1.0)


@dataclass(frozen=True, eq=False)
class SymmetryCandidate:
    """A hypothesis and its evidence: how far the turned surface is from itself.

    Attributes:
        typical, worst: meters; 99 of 100 surface points are within `typical`, all but a handful within `worst`.
        typical_excess, worst_excess: how many times their tolerances these are.
        sight_excess: how many times the least visible difference a camera sees; see :mod:`evalkit.objects.sight`.
    """

    symmetry: Symmetry
    typical: float
    worst: float
    typical_excess: float
    worst_excess: float
    sight_excess: float = 0.0

    @property
    def excess(self) -> float:
        """How many times the tolerances the surface is off; the hypothesis holds at 1 or less."""
        return max(self.typical_excess, self.worst_excess, self.sight_excess)

    @property
    def only_seen_to_be_wrong(self) -> bool:
        """Whether it is within the distances' tolerances, and a camera sees that it is none all the same."""
        return max(self.typical_excess, self.worst_excess) <= 1.0 < self.sight_excess

    @property
    def accepted(self) -> bool:
        return self.excess <= 1.0


def verify(surface: Surface, symmetry: Symmetry, points: Array) -> SymmetryCandidate:
    """Judge a hypothesis by the deviation of some `points` (n, 3) of the surface."""
    return judged(surface, symmetry, *deviation(surface, symmetry, points))


def judged(surface: Surface, symmetry: Symmetry, distance: Array, relative: Array) -> SymmetryCandidate:
    """A hypothesis and its evidence, from the :func:`deviation` of some points: distances (n,) and relative ones."""
    return SymmetryCandidate(
        symmetry,
        typical=float(np.quantile(distance, 0.99)) * surface.radius,
        worst=float(np.partition(distance, -HANDFUL)[-HANDFUL]) * surface.radius,
        typical_excess=float(np.quantile(relative, 0.99)) / TYPICAL_TOLERANCE,
        worst_excess=float(np.partition(relative, -HANDFUL)[-HANDFUL]) / WORST_TOLERANCE,
    )


def deviation(surface: Surface, symmetry: Symmetry, points: Array) -> tuple[Array, Array]:
    """Distance (n,) to the surface of its points (n, 3), each turned by some element, and the same over the lever.

    A rough surface is off itself even where it is symmetric: noise lengthens the lever, within limits.
    """
    elements = spread_elements(symmetry, len(points))
    distance = surface.distance(turned(elements, points))
    lever = _lever(symmetry, elements, surface.points[:ROUGHLY])
    return distance, distance / np.clip(NOISE_LEVERS * surface.roughness, lever, MOST_STRETCHED * lever)


def _lever(symmetry: Symmetry, elements: Array, points: Array) -> Array:
    """What a turn's tolerance scales with (n,): the bounding radius, and the less of it the thinner about the axis.

    A bar's square section would pass for round if its deviation were compared with the bar's length; a mesh's noise
    does not shrink with the section. Hence the geometric mean of both radii for turns about the main axis.
    """
    axis = symmetry.axis
    radius = np.sqrt(((points**2).sum(1) - (points @ axis) ** 2).max())
    about_axis = np.abs(elements @ axis - axis).max(1) < 1e-6
    return np.where(about_axis, np.sqrt(radius), 1.0)


def spread_elements(symmetry: Symmetry, count: int) -> Array:
    """`count` elements (count, 3, 3) other than the identity: the whole group evenly, in a fixed random order."""
    rng = np.random.default_rng(0)
    finite = symmetry.rotations
    if symmetry.kind == "sphere":
        return poses.random_rotations(rng, count)
    if symmetry.kind == "revolution":
        turns = poses.from_axis_angle(symmetry.axis, rng.random(count) * (2 * np.pi))
        return poses.compose(finite[np.arange(count) % len(finite)], turns)
    return finite[1 + rng.permutation(np.arange(count) % (len(finite) - 1))]


def turned(elements: Array, points: Array) -> Array:
    """Each point (n, 3) turned by its own element (n, 3, 3)."""
    return np.einsum("nij,nj->ni", elements, points)


def refine(
    surface: Surface, symmetry: Symmetry, keep_axis: bool = False, count: int = 1500, steps: int = 6
) -> Symmetry:
    """Turn the group's frame to where the surface keeps to it best: Gauss-Newton, point to plane.

    Turning the frame by a small w moves the turned point y = g p by w × y - g (w × p), hence its distance n·(y - q)
    from the surface's plane (q, n) by w·(y × n + gᵀn × p). With `keep_axis` w is along the main axis.
    """
    points = surface.points[:count]
    for _ in range(steps if symmetry.kind != "sphere" else 0):
        elements = spread_elements(symmetry, len(points))
        moved = turned(elements, points)
        distance, residual, normal = surface.nearest(moved)
        free = symmetry.axis[None] if keep_axis else np.eye(3)
        jacobian = np.cross(moved, normal) + np.cross(turned(np.swapaxes(elements, 1, 2), normal), points)
        trusted = distance <= max(TYPICAL_TOLERANCE, 3 * float(np.median(distance)))
        a, b = np.einsum("ni,fi->nf", jacobian[trusted], free), residual[trusted]
        damping = 1e-6 * count * np.eye(len(free))  # turns that leave the group as it is have no gradient
        step = solve_positive(np.einsum("nf,ng->fg", a, a) + damping, np.einsum("nf,n->f", a, b))
        turn = -np.einsum("f,fi->i", step, free)  # no BLAS anywhere here: bits that hold
        angle = float(np.sqrt((turn * turn).sum()))
        if angle < 1e-5:
            break
        symmetry = symmetry.rotated(poses.from_axis_angle(turn / angle, min(angle, 0.1)))
    return symmetry


def scan(surface: Surface, name: str, axes: Array, spins: int = 1, most: int = 12) -> list[Symmetry]:
    """The group `name` along those of `axes` (n, 3) where it roughly fits best, at least 12 degrees apart.

    `spins` positions about the axis are tried over half a turn, as dihedral and polyhedral groups need.
    """
    frames = _frames(axes, spins)
    scores = _rough_scores(surface, Symmetry.parse(name), frames)
    chosen: list[Symmetry] = []
    for index in np.argsort(scores):
        if len(chosen) == most or (chosen and scores[index] > ROUGH_LIMIT):
            break
        if not any(same_axis(frames[index, :, 2], other.axis, np.radians(12)) for other in chosen):
            chosen.append(Symmetry.parse(name, frames[index]))
    return chosen


def _frames(axes: Array, spins: int) -> Array:
    """Frames (n * spins, 3, 3) with z along each of `axes` (n, 3), turned about it over half a turn."""
    bases = poses.rotation_between([0.0, 0.0, 1.0], axes)
    turns = poses.from_axis_angle([0.0, 0.0, 1.0], np.arange(spins) * (np.pi / spins))
    return poses.compose(bases[:, None], turns).reshape(-1, 3, 3)


def _rough_scores(surface: Surface, group: Symmetry, frames: Array, count: int = 250, chunk: int = 1000) -> Array:
    """Mean rough distance of `count` turned points, for the group in each of `frames` (m, 3, 3)."""
    points, elements = surface.points[:count], spread_elements(group, count)
    scores = []
    for start in range(0, len(frames), chunk):
        frame = frames[start : start + chunk]
        in_frame = points @ frame
        moved = np.einsum("nij,mnj->mni", elements, in_frame) @ np.swapaxes(frame, 1, 2)
        scores.append(surface.rough_distance(moved).mean(1))
    return np.concatenate(scores)


def fit(surface: Surface, name: str, axis: Array | None = None) -> SymmetryCandidate:
    """The group `name` placed where the surface keeps to it best; along the unit vector `axis` (3,) if given.

    Raises:
        InputError: the name is not known.
    """
    group = Symmetry.parse(name)
    spins = 1 if len(group.rotations) == group.fold or group.kind != "finite" else 36
    axes = np.concatenate([principal_axes(surface.covariance)[1].T, hemisphere(600)]) if axis is None else axis[None]
    likely = [refine(surface, guess, keep_axis=axis is not None) for guess in scan(surface, name, axes, spins)]
    best = min(likely, key=lambda symmetry: verify(surface, symmetry, surface.points[:3000]).excess)
    return verify(surface, best, surface.points[:DENSE])


def snapped(surface: Surface, candidate: SymmetryCandidate) -> SymmetryCandidate:
    """The candidate with its frame on the coordinate axes, where it nearly lies on them and fits as well there."""
    frame = _nearest_axes(candidate.symmetry)
    if frame is None:
        return candidate
    straight = verify(surface, Symmetry.parse(candidate.symmetry.name, frame), surface.points[:DENSE])
    straight = replace(straight, sight_excess=candidate.sight_excess)
    as_good = straight.typical <= 1.1 * candidate.typical and straight.excess <= max(1.0, candidate.excess)
    return straight if as_good else candidate


def _nearest_axes(symmetry: Symmetry) -> Array | None:
    """A frame (3, 3) near one of the group's that lies on the coordinate axes, wholly or by its main axis alone."""
    coordinate_frames = np.round(Symmetry.parse("octahedral").rotations)
    plainness = 10 * coordinate_frames[:, :, 2].sum(1) + np.trace(coordinate_frames, axis1=1, axis2=2)
    along = coordinate_frames[:, :, 2] @ symmetry.axis > np.cos(SNAP_ANGLE)
    if symmetry.kind == "revolution" or symmetry.name.startswith("cyclic"):
        near = along | (coordinate_frames[:, :, 2] @ symmetry.axis < -np.cos(SNAP_ANGLE))
    else:
        same_group = symmetry.obj_from_sym @ Symmetry.parse(_normalizer(symmetry.name)).rotations
        near = poses.rotation_angle(same_group[:, None], coordinate_frames).min(0) < SNAP_ANGLE
    if near.any():
        return coordinate_frames[np.where(near, plainness, -np.inf).argmax()]
    if along.any():
        onto = poses.rotation_between(symmetry.axis, coordinate_frames[along.argmax(), :, 2])
        return poses.compose(onto, symmetry.obj_from_sym)
    return None


def _normalizer(name: str) -> str:
    """The group of the turns of its frame that leave a finite group as it is."""
    kind, _, fold = name.partition(":")
    if name in ("tetrahedral", "dihedral:2"):
        return "octahedral"
    return f"dihedral:{2 * int(fold)}" if kind == "dihedral" else name


def about(name: str, axis: Array) -> Symmetry:
    """The group `name` with its main axis along the unit vector `axis` (3,)."""
    return Symmetry.parse(name, poses.rotation_between([0.0, 0.0, 1.0], axis))


def same_axis(a: Array, b: Array, tolerance: float = np.radians(4.0)) -> bool:
    """Whether two unit vectors (3,) span nearly the same line."""
    return bool(abs(float(a @ b)) > np.cos(tolerance))


def hemisphere(count: int) -> Array:
    """Directions (count, 3) spread evenly over half a sphere."""
    return sphere_directions(2 * count)[:count]
