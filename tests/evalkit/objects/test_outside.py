"""What cannot be seen from outside counts for nothing, and what can be seen is never taken for hidden."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.objects.model import ObjectModel
from evalkit.objects.outside import seen_from_outside
from evalkit.objects.symmetry_detection import detect_symmetry

Mesh = trimesh.Trimesh
SHELL = trimesh.creation.cylinder(0.02, 0.08, sections=96)
PIN = trimesh.creation.box((0.010, 0.012, 0.020)).apply_translation((0.008, 0, 0.02))


def together(*parts: Mesh) -> Mesh:
    return trimesh.util.concatenate(parts)


def soup(mesh: Mesh) -> Mesh:
    """As STL stores it: every face has vertices of its own."""
    return Mesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)


@pytest.mark.parametrize("store", [lambda mesh: mesh, soup])
def test_an_inner_body_is_hidden_and_its_housing_is_not(store) -> None:  # type: ignore[no-untyped-def]
    seen = seen_from_outside(*(lambda m: (m.vertices, m.faces))(store(together(SHELL, PIN))))
    assert seen[: len(SHELL.faces)].all() and not seen[len(SHELL.faces) :].any()


def test_an_inner_body_moves_neither_centroid_nor_size_nor_symmetry() -> None:
    both, alone = together(SHELL, PIN), ObjectModel.from_mesh("shell", SHELL.vertices, SHELL.faces)
    model = ObjectModel.from_mesh("shell", both.vertices, both.faces)
    assert np.array_equal(model.centroid, alone.centroid) and np.array_equal(model.lam, alone.lam)
    assert model.diameter == alone.diameter and np.array_equal(model.points, alone.points)  # type: ignore[arg-type]
    assert detect_symmetry(both.vertices, both.faces).symmetry.name == "revolution-flip"


def test_a_cavity_and_a_thin_housings_inside_are_hidden() -> None:
    for wall in (0.004, 0.001):
        inner = trimesh.creation.cylinder(0.02 - wall, 0.08 - 2 * wall, sections=96)
        inner.invert()
        mesh = together(SHELL, inner)
        seen = seen_from_outside(mesh.vertices, mesh.faces)
        assert seen[: len(SHELL.faces)].all() and not seen[len(SHELL.faces) :].any()


def test_faces_in_contact_between_two_bodies_are_hidden() -> None:
    below = trimesh.creation.box((0.04, 0.04, 0.02))
    above = trimesh.creation.box((0.04, 0.04, 0.06)).apply_translation((0, 0, 0.04))
    mesh = together(below, above)
    seen = seen_from_outside(mesh.vertices, mesh.faces)
    middle = np.isclose(mesh.triangles[:, :, 2], 0.01).all(1)
    assert np.array_equal(seen, ~middle)


@pytest.mark.parametrize(
    "mesh",
    [
        together(SHELL, PIN.copy().apply_translation((0.1, 0, 0))),
        together(
            trimesh.creation.annulus(0.03, 0.032, 0.1, sections=48), PIN
        ),  # an open tube: one looks in at its ends
        together(trimesh.creation.torus(0.05, 0.01), trimesh.creation.icosphere(3, 0.02)),
    ],
    ids=["side by side", "in an open tube", "ball in a ring"],
)
def test_separate_bodies_that_can_be_seen_all_count(mesh: Mesh) -> None:
    assert seen_from_outside(mesh.vertices, mesh.faces).all()


def test_a_single_body_is_kept_whole_however_deep_its_crevices() -> None:
    coil = trimesh.creation.torus(0.05, 0.02, major_sections=32, minor_sections=16)
    assert seen_from_outside(coil.vertices, coil.faces).all()
    assert seen_from_outside(np.zeros((0, 3)), np.zeros((0, 3), int)).shape == (0,)
