"""Built-in objects are sound bodies of a sensible size, and have the symmetry that they declare."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.geometry import poses
from evalkit.objects.symmetry import Symmetry
from evalkit.objects.symmetry_detection import detect_symmetry, resolve_symmetry
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.objects.mending import mend


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


# ---- symmetry is found however the object is placed, tessellated and roughened ----


def tessellated(mesh: trimesh.Trimesh, how: str) -> trimesh.Trimesh:
    """The same surface of other triangles, or of rough ones: ``noise 0.5`` is a standard deviation in % of diameter.

    Decimation is told to be faithful: by default it takes a tenth of the diameter off the candlestick's socket.
    """
    fine = mesh
    while len(fine.faces) < 6000:
        fine = fine.subdivide()
    if how == "finely":
        return fine
    if how == "coarsely":
        return fine.simplify_quadric_decimation(face_count=1500, aggression=1)
    if how == "unevenly":
        left = mesh.triangles_center[:, 0] < mesh.centroid[0]
        parts = [mesh.submesh([np.flatnonzero(side)])[0] for side in (left, ~left)]
        return trimesh.util.concatenate([parts[0].subdivide().subdivide(), parts[1]])
    diameter = 2 * np.linalg.norm(mesh.vertices - mesh.centroid, axis=1).max()
    noise = np.random.default_rng(1).normal(0, float(how.split()[1]) / 100 * diameter, fine.vertices.shape)
    return trimesh.Trimesh(fine.vertices + noise, fine.faces, process=False)


WAYS = ("finely", "coarsely", "unevenly", "noise 0.1", "noise 0.3", "noise 0.5")
FAST = {("pepper", "noise 0.5"), ("brick", "noise 0.5"), ("cup", "coarsely"), ("gear", "unevenly"), ("bunny", "finely")}
MATRIX = [
    pytest.param(name, how, marks=[pytest.mark.slow] * ((name, how) not in FAST))
    for name in BUILTIN_OBJECTS
    for how in WAYS
]


@pytest.mark.parametrize(("name", "how"), MATRIX)
def test_neither_tessellation_nor_noise_nor_placement_nor_unit_fools_detection(name: str, how: str) -> None:
    builtin = BUILTIN_OBJECTS[name]
    mesh = tessellated(trimesh.Trimesh(*builtin.make(), process=False), how)
    rng = np.random.default_rng(len(name) + len(how))
    rotation = poses.random_rotations(rng, 1)[0]
    unit = float(rng.choice([1.0, 1e3]))
    found = detect_symmetry((mesh.vertices @ rotation.T + rng.normal(size=3)) * unit, mesh.faces).symmetry
    assert found.name == builtin.symmetry
    if found.name.startswith(("revolution", "cyclic")):
        assert abs(found.axis @ rotation[:, 2]) > np.cos(np.radians(1.0))


@pytest.mark.parametrize("name", ["brick", pytest.param("cup", marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise", ["noise 0.3", "noise 0.5"])
def test_noise_does_not_hide_a_feature_of_three_per_cent(name: str, noise: str) -> None:
    mesh = trimesh.Trimesh(*BUILTIN_OBJECTS[name].make(), process=False)
    side = 0.06 * np.linalg.norm(mesh.extents)  # a cube half sunk into the top, aside of every axis
    top = mesh.vertices[mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-6]
    at = np.array([*(top.max(0)[:2] * 0.95), top[0, 2]]) if name == "brick" else top[np.argmax(top[:, 0])]
    boss = trimesh.creation.box([side] * 3).subdivide().subdivide().apply_translation(at)
    rough = tessellated(trimesh.util.concatenate([mesh, boss]), noise)
    assert detect_symmetry(rough.vertices, rough.faces).symmetry.name == "none"
