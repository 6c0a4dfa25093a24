"""Noise is measured and allowed for, and no more than it: not a thin part's curvature, nor what opens or closes it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.objects.surface import Surface
from evalkit.objects.symmetry_detection import detect_symmetry

Mesh = trimesh.Trimesh
LENGTH, OUTER, INNER = 0.2, 0.005, 0.004  # meters, of a tube twenty times as long as thick


def lathe(*profile: tuple[float, float], sections: int = 24) -> Mesh:
    return trimesh.creation.revolve(np.array(profile), sections=sections)


def open_tube() -> Mesh:
    return lathe((INNER, 0), (OUTER, 0), (OUTER, LENGTH), (INNER, LENGTH), (INNER, 0))


def closed_tube() -> Mesh:
    floor = OUTER - INNER
    return lathe((0, 0), (OUTER, 0), (OUTER, LENGTH), (INNER, LENGTH), (INNER, floor), (0, floor))


def slotted_tube() -> Mesh:
    slot = trimesh.creation.box((OUTER, 0.006, 0.03)).apply_translation((OUTER, 0, 0.03))
    return trimesh.boolean.difference([open_tube(), slot])


def cylinder() -> Mesh:
    return lathe((0, -0.06), (0.04, -0.06), (0.04, 0.06), (0, 0.06), sections=48)


def scanned(mesh: Mesh, edge: float, noise: float) -> Mesh:
    """The mesh in triangles with sides below `edge` meters, whose vertices are off by `noise` meters."""
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, edge, max_iter=20)
    rough = Mesh(vertices, faces)  # shares vertices again
    rough.vertices += np.random.default_rng(1).normal(0, noise, rough.vertices.shape)
    return rough


@pytest.mark.parametrize("noise", [0.0006])
def test_a_rough_scan_of_a_cylinder_keeps_its_symmetry(noise: float) -> None:
    mesh = scanned(cylinder(), 0.007, noise)
    assert detect_symmetry(mesh.vertices, mesh.faces).symmetry.name == "revolution-flip"


@pytest.mark.parametrize("noise", [0.0, 0.0002])
@pytest.mark.parametrize(
    ("tube", "expected"), [(open_tube, "revolution-flip"), (closed_tube, "revolution"), (slotted_tube, "none")]
)
def test_what_closes_or_opens_a_thin_tube_keeps_it_from_being_flipped(tube, expected: str, noise: float) -> None:  # type: ignore[no-untyped-def]
    mesh = scanned(tube(), 0.02, noise) if noise else tube()
    assert detect_symmetry(mesh.vertices, mesh.faces).symmetry.name == expected


@pytest.mark.parametrize("make", [open_tube, closed_tube, cylinder])
def test_a_clean_mesh_is_not_rough_however_thin_it_is(make) -> None:  # type: ignore[no-untyped-def]
    mesh = make()
    assert Surface.from_mesh(mesh.vertices, mesh.faces).roughness < 2e-4


def test_roughness_grows_with_the_noise() -> None:
    """Of the bounding radius, and less than what each vertex is off, for faces are smooth between vertices."""
    radius, measured = float(np.hypot(0.04, 0.06)), []
    for noise in (0.0003, 0.0006):
        mesh = scanned(cylinder(), 0.006, noise)
        measured.append(Surface.from_mesh(mesh.vertices, mesh.faces).roughness)
        assert 0.2 * noise / radius < measured[-1] < noise / radius
    assert measured[1] == pytest.approx(2 * measured[0], rel=0.15)
