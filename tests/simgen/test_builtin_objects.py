"""Built-in objects are sound bodies of a sensible size, and have the symmetry that they declare."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.symmetry import Symmetry
from evalkit.symmetry_detection import detect_symmetry, resolve_symmetry
from simgen.builtin_objects import BUILTIN_OBJECTS
from simgen.mesh_mending import mend


@pytest.mark.parametrize("name", BUILTIN_OBJECTS)
def test_a_built_in_object_is_one_closed_body_that_needs_no_mending(name: str) -> None:
    vertices, faces = BUILTIN_OBJECTS[name].make()
    mesh = mend(vertices, faces)
    assert mesh.warnings == []
    assert mesh.is_watertight and mesh.components == 1 and mesh.volume > 0
    assert len(mesh.faces) == len(faces)
    assert len(faces) < 6000


@pytest.mark.parametrize("name", BUILTIN_OBJECTS)
def test_a_built_in_object_fits_a_hand(name: str) -> None:
    vertices, _ = BUILTIN_OBJECTS[name].make()
    assert 0.05 < np.ptp(vertices, axis=0).max() < 0.15
    assert np.ptp(vertices, axis=0).min() > 0.02


@pytest.mark.parametrize("name", BUILTIN_OBJECTS)
def test_detection_finds_the_declared_symmetry(name: str) -> None:
    builtin = BUILTIN_OBJECTS[name]
    found = detect_symmetry(*builtin.make())
    assert found.symmetry.name == builtin.symmetry
    if builtin.symmetry.startswith(("revolution", "cyclic")):
        assert found.symmetry.axis == pytest.approx([0, 0, 1])


def test_together_they_have_every_class_of_symmetry_that_parts_in_bins_have() -> None:
    kinds = {Symmetry.parse(builtin.symmetry).name.partition(":")[0] for builtin in BUILTIN_OBJECTS.values()}
    assert {"none", "cyclic", "dihedral", "revolution"} <= kinds


def test_the_gear_maps_onto_itself_by_one_tooth_and_by_no_less() -> None:
    vertices, faces = BUILTIN_OBJECTS["gear"].make()
    assert resolve_symmetry(vertices, faces, "cyclic:16@z").candidates[0].accepted
    assert not resolve_symmetry(vertices, faces, "cyclic:32@z").candidates[0].accepted
    assert not resolve_symmetry(vertices, faces, "dihedral:16@z").candidates[0].accepted


def test_making_an_object_twice_gives_the_same_mesh() -> None:
    for builtin in BUILTIN_OBJECTS.values():
        for first, second in zip(builtin.make(), builtin.make(), strict=True):
            assert np.array_equal(first, second)
