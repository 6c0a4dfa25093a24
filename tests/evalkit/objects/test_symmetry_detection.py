"""The symmetry of a shape is found however it is placed, tessellated and roughened, and what breaks it is noticed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.symmetry import Symmetry
from evalkit.objects.symmetry_detection import detect_symmetry, resolve_symmetry
from evalkit.objects.symmetry_fit import same_axis

Mesh = trimesh.Trimesh


def prism(outline: np.ndarray, height: float) -> Mesh:
    """Outline (n, 2), star-shaped about the origin, raised along z."""
    n = len(outline)
    vertices = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (-height / 2, height / 2)])
    vertices = np.concatenate([vertices, [[0, 0, -height / 2], [0, 0, height / 2]]])
    i = np.arange(n)
    j = (i + 1) % n
    sides = [np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]
    caps = [np.stack([j, i, np.full(n, 2 * n)], 1), np.stack([i + n, j + n, np.full(n, 2 * n + 1)], 1)]
    return Mesh(vertices, np.concatenate(sides + caps), process=False)


def outline(radii: np.ndarray) -> np.ndarray:
    angle = np.arange(len(radii)) * (2 * np.pi / len(radii))
    return np.column_stack([radii * np.cos(angle), radii * np.sin(angle)])


def polygon(sides: int, height: float) -> Mesh:
    return prism(outline(np.ones(sides)), height)


def gear(teeth: int, depth: float, height: float) -> Mesh:
    return prism(outline(np.where(np.arange(4 * teeth) // 2 % 2 == 0, 1.0, 1.0 - depth)), height)


def ratchet(teeth: int) -> Mesh:
    """Saw teeth: the flat plate's flip would reverse them."""
    return prism(outline(1.0 - 0.2 * (np.arange(8 * teeth) % 8) / 8), 0.4)


def box(*sides: float, at: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    return trimesh.creation.box(sides).apply_translation(at)


def together(*parts: Mesh) -> Mesh:
    return trimesh.util.concatenate(parts)


def lathe(*profile: tuple[float, float]) -> Mesh:
    return trimesh.creation.revolve(np.array(profile), sections=64)


SHAPES: dict[str, tuple[str, object]] = {
    "cylinder": ("revolution-flip", lambda: polygon(64, 3.0)),
    "cylinder of 32 facets": ("revolution-flip", lambda: polygon(32, 1.5)),
    "cylinder of equal moments": ("revolution-flip", lambda: polygon(64, np.sqrt(2))),
    "coin": ("revolution-flip", lambda: polygon(64, 0.1)),
    "torus": ("revolution-flip", lambda: trimesh.creation.torus(1.0, 0.3)),
    "cone": ("revolution", lambda: lathe((0, 0), (1, 0), (0.3, 2), (0, 2))),
    "cup": ("revolution", lambda: lathe((0, 0), (0.3, 0), (0.4, 1), (0.37, 1), (0.27, 0.05), (0, 0.05))),
    "ball": ("sphere", lambda: trimesh.creation.icosphere(3)),
    "hex nut": ("dihedral:6", lambda: polygon(6, 0.8)),
    "hex rod": ("dihedral:6", lambda: polygon(6, 8.0)),
    "brick": ("dihedral:2", lambda: box(0.6, 1.0, 2.2)),
    "thin plate": ("dihedral:2", lambda: box(2.0, 3.0, 0.02)),
    "square bar": ("dihedral:4", lambda: box(1.0, 1.0, 4.0)),
    "long square bar": ("dihedral:4", lambda: box(1.0, 1.0, 20.0)),
    "gear of 17 teeth": ("dihedral:17", lambda: gear(17, 0.1, 0.5)),
    "gear of 40 fine teeth": ("dihedral:40", lambda: gear(40, 0.06, 0.3)),
    "gear with a hub": ("cyclic:12", lambda: together(gear(12, 0.1, 0.3), polygon(48, 1).apply_scale([0.5, 0.5, 0.6]).apply_translation([0, 0, 0.3]))),  # noqa: E501
    "ratchet": ("cyclic:7", lambda: ratchet(7)),
    "connector": ("cyclic:2", lambda: together(box(2, 1, 0.5), box(0.4, 0.3, 0.3, at=(0.8, 0.3, 0.4)), box(0.4, 0.3, 0.3, at=(-0.8, -0.3, 0.4)))),  # noqa: E501
    "cube": ("octahedral", lambda: box(1, 1, 1)),
    "octahedron": ("octahedral", lambda: trimesh.convex.convex_hull(np.concatenate([np.eye(3), -np.eye(3)]))),
    "tetrahedron": ("tetrahedral", lambda: trimesh.convex.convex_hull(box(1, 1, 1).vertices[[0, 3, 5, 6]])),
    "icosahedron": ("icosahedral", trimesh.creation.icosahedron),
    "plain pieces": ("none", lambda: together(box(2, 1, 0.5), box(0.4, 0.3, 0.3, at=(0.8, 0.3, 0.4)))),
}  # fmt: skip
"""What breaks a symmetry is 2.5 to 3 per cent of the diameter deep."""
FEATURES: dict[str, tuple[str, object]] = {
    "box with a small boss": ("none", lambda: together(box(2, 1, 0.5), box(0.14, 0.12, 0.12, at=(1.0, 0.3, 0.1)))),
    "cylinder with a small key": ("none", lambda: together(polygon(64, 3.0), box(0.2, 0.15, 0.15, at=(1.0, 0, 0.5)))),
    "cube with a dot aside": ("none", lambda: together(box(1, 1, 1), box(0.1, 0.1, 0.1, at=(0.2, 0.3, 0.5)))),
    "cube with a dot in the middle": ("cyclic:4", lambda: together(box(1, 1, 1), box(0.1, 0.1, 0.1, at=(0, 0, 0.5)))),
    "cylinder with two dots": ("cyclic:2", lambda: together(polygon(64, 2.0), box(0.1, 0.1, 0.16, at=(0.6, 0, 1)), box(0.1, 0.1, 0.16, at=(-0.6, 0, 1)))),  # noqa: E501
}  # fmt: skip
ROUGH = ("cone", "hex nut", "connector", "plain pieces")
"""Shapes for the tests that take several detections each; the thorough rest is slow."""
ROUGH_AND_SLOW = [
    *ROUGH,
    *(pytest.param(n, marks=pytest.mark.slow) for n in ("cylinder", "brick", "square bar", "cube")),
]
THOROUGH = ("octahedron", "icosahedron", "hex rod", "torus", "gear of 40 fine teeth", "cylinder of 32 facets", "coin")
EVERY_SHAPE = [pytest.param(n, marks=[pytest.mark.slow] * (n in THOROUGH)) for n in SHAPES | FEATURES]


@cache
def shape(name: str) -> tuple[str, Mesh]:
    symmetry, make = (SHAPES | FEATURES)[name]
    return symmetry, make()  # type: ignore[operator]


def moved(mesh: Mesh, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The mesh's vertices turned and shifted at random, and the rotation (3, 3)."""
    rng = np.random.default_rng(seed)
    rotation = poses.random_rotations(rng, 1)[0]
    pose = poses.from_rotation_translation(rotation, rng.normal(size=3))
    return poses.apply(pose, mesh.vertices), rotation


def finely(mesh: Mesh, faces: int = 6000) -> Mesh:
    while len(mesh.faces) < faces:
        mesh = mesh.subdivide()
    return mesh


@pytest.mark.parametrize("name", EVERY_SHAPE)
def test_the_symmetry_is_found_where_the_shape_lies(name: str) -> None:
    expected, mesh = shape(name)
    vertices, rotation = moved(mesh, seed=len(name))
    found = detect_symmetry(vertices, mesh.faces)
    assert found.symmetry.name == expected
    assert_maps_onto_itself(found.symmetry, vertices, mesh.faces)
    main_axis_is_known = expected.startswith(("revolution", "cyclic")) or expected in ("dihedral:6", "dihedral:17")
    if main_axis_is_known and name != "plain pieces":
        assert same_axis(found.symmetry.axis, rotation[:, 2], np.radians(0.5))


def assert_maps_onto_itself(symmetry: Symmetry, vertices: np.ndarray, faces: np.ndarray) -> None:
    """By another way than detection measures it: every vertex, turned, lies on the mesh (trimesh's exact distance)."""
    mesh = Mesh(vertices, faces, process=False)
    centroid = mesh.area_faces @ mesh.triangles_center / mesh.area
    elements = symmetry.elements(steps=8)[:24]
    turned = (vertices[::7] - centroid) @ np.swapaxes(elements, 1, 2) + centroid
    _, distance, _ = trimesh.proximity.closest_point_naive(mesh, turned.reshape(-1, 3)[:400])
    assert distance.max() < 0.02 * np.linalg.norm(mesh.extents)


@pytest.mark.parametrize("name", ROUGH_AND_SLOW)
def test_the_tessellation_does_not_matter(name: str) -> None:
    expected, mesh = shape(name)
    fine = finely(mesh)
    rng = np.random.default_rng(3)
    part = fine.submesh([np.arange(len(fine.faces)) < len(fine.faces) // 2])[0].subdivide()
    rest = fine.submesh([np.arange(len(fine.faces)) >= len(fine.faces) // 2])[0]
    uneven = together(part, rest)
    shuffled = Mesh(fine.vertices, fine.faces[rng.permutation(len(fine.faces))], process=False)
    for variant in (uneven, shuffled, fine.simplify_quadric_decimation(face_count=1500)):
        vertices, _ = moved(variant, seed=4)
        assert detect_symmetry(vertices, variant.faces).symmetry.name == expected


@pytest.mark.parametrize("name", ROUGH_AND_SLOW)
def test_noise_of_a_third_of_a_per_cent_does_not_matter(name: str) -> None:
    expected, mesh = shape(name)
    fine = finely(mesh)
    vertices, _ = moved(fine, seed=5)
    vertices += np.random.default_rng(6).normal(0, 0.003 * np.ptp(vertices, axis=0).max(), vertices.shape)
    assert detect_symmetry(vertices, fine.faces).symmetry.name == expected


@pytest.mark.parametrize("name", ["brick", "connector"])
@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_size_does_not_matter_and_the_residual_grows_with_it(name: str, size: float) -> None:
    expected, mesh = shape(name)
    plain, scaled = detect_symmetry(mesh.vertices, mesh.faces), detect_symmetry(mesh.vertices * size, mesh.faces)
    assert scaled.symmetry.name == expected
    assert scaled.relative_residual == pytest.approx(plain.relative_residual, rel=1e-3)
    assert scaled.residual == pytest.approx(plain.residual * size, rel=1e-3)


@pytest.mark.parametrize("name", ["brick", "cone", "hex nut", "cube"])
def test_a_shape_along_the_coordinate_axes_gets_its_frame_there(name: str) -> None:
    _, mesh = shape(name)
    assert np.array_equal(detect_symmetry(mesh.vertices, mesh.faces).symmetry.obj_from_sym, np.eye(3))


def test_a_main_axis_along_a_coordinate_axis_is_exactly_there() -> None:
    _, mesh = shape("hex nut")
    turned = mesh.copy().apply_transform(trimesh.transformations.rotation_matrix(0.3, [0, 0, 1]))
    found = detect_symmetry(turned.vertices, turned.faces).symmetry
    assert np.abs(found.axis) == pytest.approx([0, 0, 1], abs=1e-12)
    half_turn = found.obj_from_sym[:, 0]
    sixth = np.arctan2(half_turn[1], half_turn[0]) - 0.3
    assert (sixth + 0.01) % (np.pi / 6) == pytest.approx(0.01, abs=2e-3)


def test_evidence_is_given_for_what_is_found_and_for_what_is_not() -> None:
    _, bar = shape("square bar")
    found = detect_symmetry(bar.vertices, bar.faces)
    assert found.evidence is not None and found.evidence.accepted
    assert found.residual == found.evidence.typical <= found.evidence.worst
    assert found.runner_up is not None and not found.runner_up.accepted
    _, plain = shape("plain pieces")
    nothing = detect_symmetry(plain.vertices, plain.faces)
    assert nothing.evidence is None and nothing.residual == 0
    assert nothing.runner_up is not None and nothing.runner_up.excess > 1


def test_the_worst_distance_is_the_depth_of_what_breaks_the_symmetry() -> None:
    base = box(2, 1, 0.5)
    for depth in (0.1, 0.2):
        mesh = together(base, box(0.3, 0.3, 2 * depth, at=(0.6, 0.2, 0.25)))
        found = resolve_symmetry(mesh.vertices, mesh.faces, "cyclic:2@z")
        assert found.candidates[0].worst == pytest.approx(depth, abs=0.03)


@pytest.mark.parametrize("name", ["hex nut", "cup", "tetrahedron", "gear with a hub"])
def test_a_group_asked_for_is_placed_where_it_fits(name: str) -> None:
    expected, mesh = shape(name)
    vertices, _ = moved(mesh, seed=8)
    asked = resolve_symmetry(vertices, mesh.faces, expected)
    assert asked.symmetry.name == expected
    assert asked.evidence is not None and asked.evidence.accepted
    assert_maps_onto_itself(asked.symmetry, vertices, mesh.faces)


@pytest.mark.parametrize("spec", ["revolution@x", "cyclic:5@0,3,4", "dihedral:2@y", "revolution-flip@z"])
def test_an_axis_asked_for_is_kept_exactly(spec: str) -> None:
    _, mesh = shape("plain pieces")
    name, _, axis = spec.partition("@")
    found = resolve_symmetry(mesh.vertices, mesh.faces, spec)
    wanted = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1], "0,3,4": [0, 0.6, 0.8]}[axis]
    assert found.symmetry.name == name
    assert np.abs(found.symmetry.axis @ wanted) == pytest.approx(1.0, abs=1e-9)
    assert found.evidence is not None and not found.evidence.accepted


def test_half_turns_across_a_given_axis_are_placed_where_they_fit() -> None:
    mesh = box(1, 2, 3).apply_transform(trimesh.transformations.rotation_matrix(0.4, [0, 0, 1]))
    found = resolve_symmetry(mesh.vertices, mesh.faces, "dihedral:2@z")
    assert found.evidence is not None and found.evidence.accepted


def test_no_symmetry_can_be_asked_for() -> None:
    _, cube = shape("cube")
    assert resolve_symmetry(cube.vertices, cube.faces, "none").symmetry.name == "none"


@pytest.mark.parametrize(
    "spec", ["round", "cyclic:0", "cyclic", "revolution@", "revolution@w", "revolution@1,2", "none@q"]
)
def test_what_is_no_symmetry_is_refused_in_one_sentence(spec: str) -> None:
    _, cube = shape("cube")
    with pytest.raises(InputError) as error:
        resolve_symmetry(cube.vertices, cube.faces, spec)
    assert str(error.value).endswith(".") and "symmetry" in str(error.value)


def test_detection_is_the_same_every_time() -> None:
    _, mesh = shape("connector")
    first, second = (detect_symmetry(mesh.vertices, mesh.faces) for _ in range(2))
    assert np.array_equal(first.symmetry.obj_from_sym, second.symmetry.obj_from_sym)
    assert first.residual == second.residual
