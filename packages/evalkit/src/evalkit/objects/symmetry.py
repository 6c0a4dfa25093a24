"""Proper symmetry groups of rigid objects: the one notion that labels, losses and metrics share.

A symmetry acts on the object side of a pose: ``cam_from_obj @ g`` shows the same picture as ``cam_from_obj`` for every
g of the group. All symmetries fix the object's centroid, so they are kept as rotations about it. Three kinds
(Brégier et al. 2018, "Defining the pose of any 3D rigid object and an associated distance"):

========== ==================================== =====================================================
kind       names                                pose representative (Sym distance = Euclidean, minimum)
========== ==================================== =====================================================
finite     none, cyclic:N, dihedral:N,          [vec(R g Lambda); t] for every g
           tetrahedral, octahedral,
           icosahedral, finite:N
revolution revolution, revolution-flip          [lambda R axis; t], with flip also [-lambda R axis; t]
sphere     sphere                               t
========== ==================================== =====================================================
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses

Array = NDArray[np.float64]
Kind = Literal["finite", "revolution", "sphere"]
SYNTAX = "none, cyclic:N, dihedral:N, tetrahedral, octahedral, icosahedral, revolution, revolution-flip or sphere"
MAX_FOLD = 1000


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A proper symmetry group, in the object's frame.

    `obj_from_sym` (3, 3) turns the symmetry's own frame into the object's: its z is the main axis, and its x is a
    two-fold axis where the group has one beside z. `rotations` (n, 3, 3), object frame, is the whole group when it is
    finite (identity first); for a revolution it is what remains beside the continuous part (1, or 2 with flip).
    """

    name: str
    kind: Kind
    rotations: Array
    obj_from_sym: Array = field(default_factory=lambda: np.eye(3))

    @classmethod
    def parse(cls, name: str, obj_from_sym: ArrayLike | None = None) -> Symmetry:
        """Build from a name such as ``cyclic:4`` and the frame (3, 3) that its axes lie in (default: the object's).

        Raises:
            InputError: the name is none of those that the module's table lists.
        """
        frame = np.eye(3) if obj_from_sym is None else np.asarray(obj_from_sym, float)
        name = {"cyclic:1": "none", "identity": "none"}.get(name, name)
        in_sym = _group_in_symmetry_frame(name)
        kind: Kind = "sphere" if name == "sphere" else "revolution" if name.startswith("revolution") else "finite"
        return cls(name, kind, poses.compose(poses.compose(frame, in_sym), frame.T), frame)

    @classmethod
    def from_rotations(cls, rotations: ArrayLike, name: str | None = None) -> Symmetry:
        """A finite group from its elements (n, 3, 3) in the object's frame.

        Raises:
            InputError: they are not rotations, lack the identity, or are not closed under composition.
        """
        elements: Array = np.asarray(rotations, float).reshape(-1, 3, 3)
        if len(elements) == 0 or not poses.is_rotation(elements, 1e-2).all():
            raise InputError("symmetry: the group's elements must be 3x3 rotation matrices.")
        elements = poses.nearest_rotation(elements)
        products = (elements[:, None] @ elements[None]).reshape(-1, 3, 3)
        nearest = np.array([poses.rotation_angle(product, elements).min() for product in products])
        from_identity = poses.rotation_angle(np.eye(3), elements)
        if nearest.max() > 0.02 or from_identity.min() > 0.02:
            raise InputError("symmetry: the rotations given do not form a group; list all of them, identity first.")
        elements = elements[np.argsort(from_identity, kind="stable")]
        elements[0] = np.eye(3)
        return cls(name or ("none" if len(elements) == 1 else f"finite:{len(elements)}"), "finite", elements)

    @property
    def axis(self) -> Array:
        """The main axis (3,), a unit vector in the object's frame."""
        return self.obj_from_sym[:, 2]

    @property
    def has_flip(self) -> bool:
        """Whether a revolution also maps its axis to the opposite one."""
        return self.kind == "revolution" and len(self.rotations) == 2

    @property
    def spin_matters(self) -> bool:
        """Whether a turn about the main axis changes what is seen; if not, its angle is not estimated."""
        return self.kind == "finite"

    @cached_property
    def fold(self) -> int:
        """Number of group elements that turn about the main axis (1 where none does; finite groups only)."""
        return int((np.abs(self.rotations @ self.axis - self.axis).max(-1) < 1e-6).sum())

    def rotated(self, new_from_obj: ArrayLike) -> Symmetry:
        """The same symmetry seen from another frame: `new_from_obj` (3, 3)."""
        turn = np.asarray(new_from_obj, float)
        rotations = poses.compose(poses.compose(turn, self.rotations), turn.T)
        return Symmetry(self.name, self.kind, rotations, poses.compose(turn, self.obj_from_sym))

    def elements(self, steps: int = 64) -> Array:
        """Group elements (n, 3, 3), object frame, identity first; continuous groups sampled.

        `steps` turns a revolution; the sphere is sampled by the icosahedral group's 60 rotations.
        """
        if self.kind == "finite":
            return self.rotations
        if self.kind == "sphere":
            return _group_in_symmetry_frame("icosahedral")
        turns = poses.from_axis_angle(self.axis, np.arange(steps) * (2 * np.pi / steps))
        return (self.rotations[:, None] @ turns[None]).reshape(-1, 3, 3)

    def closest_equivalent(self, rotation: ArrayLike, reference: ArrayLike) -> Array:
        """Of all rotations equivalent to `rotation` (..., 3, 3) the one closest to `reference` (..., 3, 3); exact."""
        rotation, reference = np.broadcast_arrays(np.asarray(rotation, float), np.asarray(reference, float))
        if self.kind == "sphere":
            return reference.copy()
        candidates = rotation[..., None, :, :] @ self.rotations
        if self.kind == "revolution":
            candidates = self._spun_toward(candidates, reference[..., None, :, :])
        closeness = np.einsum("...nij,...ij->...n", candidates, reference)
        best = closeness.argmax(-1)[..., None, None, None]
        return np.take_along_axis(candidates, best, axis=-3)[..., 0, :, :]

    def _spun_toward(self, rotation: Array, reference: Array) -> Array:
        """rotation @ spin(angle), with the angle that brings it closest to `reference` (the trace's maximum)."""
        frame = self.obj_from_sym
        relative = frame.T @ np.swapaxes(rotation, -1, -2) @ reference @ frame
        angle = np.arctan2(relative[..., 1, 0] - relative[..., 0, 1], relative[..., 0, 0] + relative[..., 1, 1])
        return rotation @ poses.from_axis_angle(self.axis, angle)

    def representatives(self, rotation: ArrayLike, center: ArrayLike, lam: ArrayLike) -> Array:
        """Pose representatives: rotation (..., 3, 3), center (..., 3), lam (3, 3) -> (..., n, d).

        `center` is the object's centroid in the camera's frame and `lam` the square root of the area-weighted surface
        covariance about it, in the object's frame. d is 12, 6 or 3 for finite, revolution and sphere. The Sym distance
        of two poses is the smallest Euclidean distance of any representative of one to any fixed one of the other.
        """
        rotation, center, lam = (np.asarray(a, float) for a in (rotation, center, lam))
        if self.kind == "sphere":
            return center[..., None, :]
        if self.kind == "revolution":
            directions = rotation[..., None, :, :] @ (self.rotations @ self.axis)[..., None]
            shape = self.revolution_scale(lam) * directions[..., 0]
        else:
            shape = (rotation[..., None, :, :] @ self.rotations @ lam).reshape(*rotation.shape[:-2], -1, 9)
        repeated = np.broadcast_to(center[..., None, :], (*shape.shape[:-1], 3))
        return np.concatenate([shape, repeated], -1)

    def revolution_scale(self, lam: ArrayLike) -> float:
        """lambda = sqrt(l_r^2 + l_z^2): one tilt of the axis moves the surface as one of `lam` (3, 3) does."""
        squared = np.asarray(lam, float) @ np.asarray(lam, float)
        along = float(self.axis @ squared @ self.axis)
        return float(np.sqrt((np.trace(squared) - along) / 2.0 + along))

    def to_json(self) -> dict[str, Any]:
        document: dict[str, Any] = {"name": self.name, "obj_from_sym": self.obj_from_sym.tolist()}
        if self.name.startswith("finite:"):
            document["rotations"] = self.rotations.tolist()
        return document

    @classmethod
    def from_json(cls, document: Any, where: str = "symmetry") -> Symmetry:
        """Read what :meth:`to_json` writes.

        Raises:
            InputError: a field is missing or is not what it should be.
        """
        if not isinstance(document, dict) or not isinstance(document.get("name"), str):
            raise InputError(f"{where}: expected an object with 'name' ({SYNTAX}) and 'obj_from_sym'.")
        try:
            frame = np.array(document.get("obj_from_sym", np.eye(3)), dtype=float)
            rotations = np.array(document["rotations"], dtype=float) if "rotations" in document else None
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{where}: 'obj_from_sym' and 'rotations' must be 3x3 matrices of numbers.") from None
        if frame.shape != (3, 3) or not poses.is_rotation(frame):
            raise InputError(f"{where}: 'obj_from_sym' must be a 3x3 rotation matrix.")
        try:
            if document["name"].startswith("finite:") and rotations is not None:
                return cls.from_rotations(rotations, document["name"])
            return cls.parse(document["name"], frame)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None


def _group_in_symmetry_frame(name: str) -> Array:
    """The named group's rotations (n, 3, 3) in its own frame (the discrete part for continuous ones)."""
    flip = np.diag([1.0, -1.0, -1.0])
    if name in ("none", "revolution", "sphere"):
        return np.eye(3)[None]
    if name == "revolution-flip":
        return np.stack([np.eye(3), flip])
    if name in ("tetrahedral", "octahedral", "icosahedral"):
        return _polyhedral(name)
    match = re.fullmatch(r"(cyclic|dihedral):(\d{1,4})", name)
    if match is None or not 1 <= int(match[2]) <= MAX_FOLD:
        raise InputError(f"symmetry '{name}' is not known; use {SYNTAX} (N from 1 to {MAX_FOLD}).")
    fold = int(match[2])
    turns = poses.from_axis_angle([0.0, 0.0, 1.0], np.arange(fold) * (2 * np.pi / fold))
    return turns if match[1] == "cyclic" else np.concatenate([turns, turns @ flip])


@cache
def _polyhedral(name: str) -> Array:
    elements = _closure(_POLYHEDRAL_GENERATORS[name])
    elements.setflags(write=False)  # it is shared
    return elements


def _closure(generators: list[Array]) -> Array:
    elements = [np.eye(3)]
    for element in elements:  # grows while it is walked
        for generator in generators:
            product = element @ generator
            if min(np.abs(product - known).max() for known in elements) > 1e-6:
                elements.append(product)
    return poses.nearest_rotation(np.stack(elements))


_GOLDEN = (1 + np.sqrt(5)) / 2
_POLYHEDRAL_GENERATORS = {
    "tetrahedral": [np.diag([-1.0, -1.0, 1.0]), poses.from_axis_angle([1.0, 1.0, 1.0], 2 * np.pi / 3)],
    "octahedral": [
        poses.from_axis_angle([0, 0, 1.0], np.pi / 2),
        poses.from_axis_angle([1.0, 1.0, 1.0], 2 * np.pi / 3),
    ],
    "icosahedral": [
        np.diag([-1.0, -1.0, 1.0]),
        poses.from_axis_angle([1.0, 1.0, 1.0], 2 * np.pi / 3),
        poses.from_axis_angle([0.0, 1.0, _GOLDEN], 2 * np.pi / 5),
    ],
}
