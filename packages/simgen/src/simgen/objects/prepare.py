"""From a mesh file, or a built-in object's name, to an object in meters with symmetry and convex parts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import sha256_of_file
from evalkit.errors import InputError
from evalkit.geometry.principal_axes import principal_axes
from evalkit.meshes.read import FORMATS, FileMesh, read_file_mesh
from evalkit.meshes.units import METERS, WORDS, check_size, decide_units
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry_detection import DetectedSymmetry, resolve_symmetry
from evalkit.objects.symmetry_search import group_size
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.objects.convex import Part, convex_parts
from simgen.objects.mending import MendedMesh, mend

LITTLE = 0.02  # of the diameter, by which a thread misses the symmetry of its screw's head
FLAT = 1e-4  # thickness over size below which nothing can rest on or under the object


@dataclass(frozen=True, eq=False)
class PreparedObject:
    """An object and what was understood of its mesh.

    Attributes:
        model: in meters, with symmetry and mesh; its `notes` hold source, sha256, units and scale.
        convex_parts: (vertices (V, 3), faces (F, 3)) each, meters, object's frame.
        warnings: sentences to print.
        units_reason: why the file's unit is taken to be what `model.notes` says.
        mesh: the mended mesh, in meters, and its soundness.
        symmetry: what speaks for the model's symmetry.
    """

    model: ObjectModel
    convex_parts: list[Part]
    warnings: list[str]
    units_reason: str
    mesh: MendedMesh
    symmetry: DetectedSymmetry

    @property
    def summary(self) -> str:
        """One line on what was decided: unit, size, symmetry, parts."""
        sides = " x ".join(f"{1e3 * side:.4g}" for side in np.ptp(self.mesh.vertices, axis=0))
        unit = WORDS[self.model.notes["units"]]
        return (
            f"{self.model.name}: read as {unit} ({self.units_reason}), {sides} mm; symmetry {describe(self.symmetry)}; "
            f"{len(self.convex_parts)} convex parts"
        )


def describe(found: DetectedSymmetry) -> str:
    """A symmetry in words, with the residual that justifies it; for none, how far off the nearest group is."""
    if found.evidence is not None:
        axis = ", ".join(f"{x + 0.0:.3g}" for x in found.symmetry.axis)
        about = "" if found.symmetry.kind == "sphere" else f" about ({axis})"
        return f"{found.symmetry.name}{about}, residual {1e3 * found.residual:.2g} mm"
    miss = found.runner_up
    return "none" if miss is None else f"none (nearest: {miss.symmetry.name}, off by {1e3 * miss.worst:.2g} mm)"


def prepare_object(
    source: str, units: str = "auto", scale: float = 1.0, symmetry: str = "auto", name: str | None = None
) -> PreparedObject:
    """Read `source`, a mesh file or a built-in object's name, as an object in meters.

    Args:
        units: auto, m, cm, mm or inch: the file's unit; a built-in object is in meters.
        scale: factor on the size, on top of the unit.
        symmetry: auto, a group's name, or a name and its axis such as ``revolution@z``.
        name: what documents call the object; the file's or the built-in object's name if None.

    Raises:
        InputError: the file is not a usable mesh, or an option makes no sense.
    """
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"--scale {scale:g}: must be a positive number.")
    if name is not None and not name.strip():
        raise InputError("--name: is empty; name the object, or leave the option out.")
    source, substituted = _existing(source)
    own_name, found_mesh, notes = _read(source)
    mesh = mend(found_mesh.vertices, found_mesh.faces)
    _require_body(mesh, source)
    mesh, unit, reason, warnings = _in_meters(mesh, source, units, scale, found_mesh.unit)
    found = resolve_symmetry(mesh.vertices, mesh.faces, symmetry)
    notes |= {"units": unit, "scale": scale, "symmetry_from": "mesh" if symmetry == "auto" else "user"}
    model = ObjectModel.from_mesh(name or own_name, mesh.vertices, mesh.faces, found.symmetry, **notes)
    outside = _outside(model)
    if hidden := len(mesh.faces) - len(outside):
        warnings.append(f"{hidden} of {len(mesh.faces)} faces cannot be seen from outside and count for nothing.")
    parts, convex_warnings = convex_parts(mesh.vertices, outside)
    warnings += [
        *substituted,
        *mesh.warnings,
        *convex_warnings,
        *_doubts(found, symmetry),
        *_near_misses(found, symmetry, model.diameter),
    ]
    return PreparedObject(model, parts, warnings, reason, mesh, found)


def _outside(model: ObjectModel) -> NDArray[np.int64]:
    """The faces that the model kept: its hulls are made of these, so that a dataset can be repaired from its shards."""
    assert model.faces is not None
    return model.faces.astype(np.int64)


def _existing(source: str) -> tuple[str, list[str]]:
    """The source; where it names a mesh file that is not here, the built-in object of that name, and a sentence on it.

    A path with a folder in it was meant as a path: its file is missed, not replaced.
    """
    path = Path(source)
    named = path.stem in BUILTIN_OBJECTS and path.name == source and path.suffix.lower().lstrip(".") in FORMATS
    if not named or path.exists():
        return source, []
    return path.stem, [
        f"{source}: no such file, so the built-in object '{path.stem}' is taken; check the path if not meant."
    ]


def _read(source: str) -> tuple[str, FileMesh, dict[str, Any]]:
    """Name, mesh and notes on the origin of a built-in object or a file."""
    if source in BUILTIN_OBJECTS:
        builtin = BUILTIN_OBJECTS[source]
        return source, FileMesh(*builtin.make(), "m"), {"source": source, "origin": builtin.origin}
    path = Path(source)
    if not path.exists():
        raise InputError(f"{source}: no such file, nor a built-in object ({', '.join(BUILTIN_OBJECTS)}).")
    return path.stem, read_file_mesh(path), {"source": path.name, "sha256": sha256_of_file(path)}


def _require_body(mesh: MendedMesh, source: str) -> None:
    """Raise InputError unless the mesh spans three dimensions."""
    if len(mesh.faces) == 0:
        raise InputError(f"{source}: all its triangles are points or lines; export it again.")
    offset = mesh.vertices - mesh.vertices.mean(0)
    spread, _ = principal_axes(np.einsum("vi,vj->ij", offset, offset))  # squares of what it spans along its axes
    if not spread[0] > FLAT**2 * spread[2]:
        raise InputError(f"{source}: the mesh is flat; a rigid body needs thickness, so model it as a solid.")


def _in_meters(
    mesh: MendedMesh, source: str, units: str, scale: float, stated: str | None
) -> tuple[MendedMesh, str, str, list[str]]:
    """The mesh in meters, its file's unit, the reason for it, and warnings."""
    largest_side = float(np.ptp(mesh.vertices, axis=0).max())
    if source in BUILTIN_OBJECTS:
        unit, reason, warnings = "m", "a built-in object", list[str]()
    else:
        extension = Path(source).suffix.lower().lstrip(".")
        unit, reason, warnings = decide_units(units, largest_side, extension, source, stated)
    factor = METERS[unit] * scale
    warnings += check_size(largest_side * factor, source)
    scaled = replace(mesh, vertices=mesh.vertices * factor, volume=mesh.volume * factor**3)
    return scaled, unit, reason, warnings


def _near_misses(found: DetectedSymmetry, asked: str, diameter: float) -> list[str]:
    """A sentence on the largest group, larger than the one detected, that the mesh misses by very little."""
    missed = [
        candidate
        for candidate in found.candidates
        if not candidate.accepted and not candidate.only_seen_to_be_wrong and candidate.worst <= LITTLE * diameter
    ]
    largest = max(missed, key=lambda candidate: group_size(candidate.symmetry), default=None)
    if asked != "auto" or largest is None or group_size(largest.symmetry) <= group_size(found.symmetry):
        return []
    name = largest.symmetry.name
    off = f"{1e3 * largest.worst:.2g} mm, {largest.worst / diameter:.1%} of the diameter"
    return [
        f"The symmetry {name} is missed by {off}, as by a thread or a small mark; if your camera cannot see that, say "
        f"--symmetry {name}."
    ]


def _doubts(found: DetectedSymmetry, asked: str) -> list[str]:
    """Sentences on a symmetry that was asked for and that the mesh does not have."""
    evidence = found.evidence
    if asked == "auto" or evidence is None or evidence.accepted:
        return []
    return [
        f"The mesh is not that symmetric: turned by {found.symmetry.name}, 1 % of its surface is off by more than "
        f"{1e3 * evidence.typical:.3g} mm, at worst {1e3 * evidence.worst:.3g} mm; --symmetry {asked} is used as asked."
    ]
