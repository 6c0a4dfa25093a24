"""What mending must leave alone, mend, or tell."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from simgen.objects.mending import MendedMesh, closed, mend

BODIES = {
    "box": trimesh.creation.box((1, 2, 3)),
    "ring": trimesh.creation.annulus(1.0, 2.0, 0.5),
    "ball": trimesh.creation.icosphere(2),
}


@pytest.fixture(params=BODIES)
def body(request: pytest.FixtureRequest) -> trimesh.Trimesh:
    return BODIES[request.param].copy()


def mended(mesh: trimesh.Trimesh) -> MendedMesh:
    return mend(np.array(mesh.vertices, float), np.array(mesh.faces, np.int64))


def test_a_sound_mesh_gets_no_warning_and_keeps_its_shape(body: trimesh.Trimesh) -> None:
    mesh = mended(body)
    assert mesh.warnings == []
    assert mesh.is_watertight and mesh.components == 1
    assert mesh.volume == pytest.approx(body.volume)
    assert len(mesh.vertices) == len(body.vertices) and len(mesh.faces) == len(body.faces)


def test_mending_again_changes_nothing(body: trimesh.Trimesh) -> None:
    body.invert()
    once = mended(body)
    twice = mend(once.vertices, once.faces)
    assert np.array_equal(once.vertices, twice.vertices) and np.array_equal(once.faces, twice.faces)
    assert twice.warnings == []


def test_faces_with_vertices_of_their_own_are_welded(body: trimesh.Trimesh) -> None:
    soup = trimesh.Trimesh(body.triangles.reshape(-1, 3), np.arange(3 * len(body.faces)).reshape(-1, 3), process=False)
    mesh = mended(soup)
    assert mesh.is_watertight
    assert len(mesh.vertices) == len(body.vertices)


def test_an_inside_out_mesh_is_turned_round_and_told(body: trimesh.Trimesh) -> None:
    volume = body.volume
    body.invert()
    mesh = mended(body)
    assert mesh.volume == pytest.approx(volume)
    assert any("inside out" in warning for warning in mesh.warnings)


@pytest.mark.parametrize("seed", range(3))
def test_faces_flipped_at_random_are_wound_outwards_again(body: trimesh.Trimesh, seed: int) -> None:
    flipped = np.random.default_rng(seed).random(len(body.faces)) < 0.3
    faces = np.where(flipped[:, None], body.faces[:, ::-1], body.faces)
    mesh = mend(np.array(body.vertices), faces.astype(np.int64))
    assert mesh.volume == pytest.approx(body.volume)
    assert any("wound" in warning for warning in mesh.warnings)


def test_stray_vertices_do_not_count(body: trimesh.Trimesh) -> None:
    vertices = np.concatenate([[[1e9, 0, 0]], body.vertices, [[np.nan] * 3]])
    mesh = mend(vertices, np.array(body.faces, np.int64) + 1)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(np.ptp(body.vertices, axis=0))
    assert mesh.warnings == []


def test_repeated_and_collapsed_faces_are_dropped(body: trimesh.Trimesh) -> None:
    faces = np.array(body.faces, np.int64)
    more = np.concatenate([faces, faces[:3, [1, 2, 0]], faces[:2, ::-1], [[0, 0, 1], [2, 2, 2]]])
    mesh = mend(np.array(body.vertices), more)
    assert len(mesh.faces) == len(faces) and mesh.is_watertight
    assert mesh.volume == pytest.approx(body.volume)
    assert any("5 faces" in warning for warning in mesh.warnings)


def test_holes_are_told_and_closed_for_the_physics(body: trimesh.Trimesh) -> None:
    faces = np.array(body.faces, np.int64)[1:]
    mesh = mend(np.array(body.vertices), faces)
    assert not mesh.is_watertight
    assert any("watertight" in warning for warning in mesh.warnings)
    shut = trimesh.Trimesh(*closed(mesh.vertices, mesh.faces), process=False)
    assert shut.is_watertight
    assert shut.volume == pytest.approx(body.volume, rel=0.05)


def test_a_closed_mesh_stays_as_it_is_when_closed(body: trimesh.Trimesh) -> None:
    vertices, faces = closed(np.array(body.vertices), np.array(body.faces, np.int64))
    assert len(vertices) == len(body.vertices) and len(faces) == len(body.faces)


def test_an_edge_of_three_faces_is_told() -> None:
    box = BODIES["box"]
    vertices = np.concatenate([box.vertices, [[5.0, 5, 5]]])
    mesh = mend(vertices, np.concatenate([box.faces, [[*box.faces[0][:2], len(box.vertices)]]]).astype(np.int64))
    assert mesh.crowded_edges == 1
    assert any("manifold" in warning for warning in mesh.warnings)


def test_pieces_are_counted_and_told() -> None:
    two = trimesh.util.concatenate([BODIES["box"], BODIES["ball"].copy().apply_translation([9, 0, 0])])
    mesh = mended(two)
    assert mesh.components == 2 and mesh.is_watertight
    assert any("2 separate pieces" in warning for warning in mesh.warnings)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_mending_does_not_depend_on_the_unit(body: trimesh.Trimesh, scale: float) -> None:
    mesh = mend(np.array(body.vertices) * scale, np.array(body.faces, np.int64))
    assert len(mesh.vertices) == len(body.vertices)
    assert mesh.volume == pytest.approx(body.volume * scale**3)


@pytest.mark.parametrize("away", [[0, 0, 0], [3000, 2100, 900], [0, 0, -20_000]])
@pytest.mark.parametrize("name", BODIES)
def test_corners_that_float32_rounded_apart_are_one(name: str, away: list[float]) -> None:
    body = BODIES[name].copy().apply_scale(30)
    corners = (np.asarray(body.triangles) + away).astype(np.float32)
    step = np.random.default_rng(0).choice([-1, 0, 0, 1], corners.shape).astype(np.float32) * np.float32(1e6)
    corners = np.nextafter(corners, corners + step)
    mesh = mend(corners.reshape(-1, 3).astype(float), np.arange(corners.size // 3).reshape(-1, 3))
    assert mesh.is_watertight and mesh.components == 1
    assert len(mesh.vertices) == len(body.vertices)
    assert mesh.volume == pytest.approx(body.volume, rel=1e-3)


def test_fine_detail_far_from_the_origin_is_kept_where_nothing_is_open() -> None:
    ball = trimesh.creation.icosphere(3, 0.001).apply_translation([3000, 0, 0])  # edges near a rounding of float32
    mesh = mend(np.array(ball.vertices), np.array(ball.faces))
    assert len(mesh.vertices) == len(ball.vertices) and mesh.is_watertight


@pytest.mark.parametrize("copies", [0, 1])
def test_bodies_that_touch_are_one_solid(copies: int) -> None:
    """Two tetrahedra on the same three corners, in a file that holds some faces twice."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]], float)
    upper = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    lower = np.where(upper == 3, 4, upper)[:, ::-1]
    mesh = mend(vertices, np.concatenate([upper, lower, *[upper] * copies]))
    assert mesh.is_watertight and mesh.crowded_edges == 0 and mesh.components == 1
    assert mesh.volume == pytest.approx(1 / 3)
    assert any("2 faces where surfaces touch" in warning for warning in mesh.warnings)


def test_bodies_that_touch_in_other_triangles_have_an_inside() -> None:
    """A pin pressed into a plate, flush with it, whose walls are cut along other diagonals."""
    hole, pin = trimesh.creation.annulus(1.0, 3.0, 2.0, sections=24), trimesh.creation.cylinder(1.0, 2.0, sections=24)
    mesh = mended(trimesh.util.concatenate([hole, pin]))
    assert mesh.is_watertight and mesh.components == 1 and mesh.crowded_edges > 0
    assert mesh.volume == pytest.approx(hole.volume + pin.volume)


def test_bodies_that_touch_along_an_edge_have_an_inside() -> None:
    other = BODIES["box"].copy().apply_translation([1, 2, 0])
    mesh = mended(trimesh.util.concatenate([BODIES["box"], other]))
    assert mesh.crowded_edges == 1 and mesh.is_watertight
    assert mesh.volume == pytest.approx(2 * other.volume)


def test_a_sheet_drawn_from_both_sides_is_no_contact() -> None:
    """A fin on a box, without thickness, each of its faces there from both sides."""
    box = BODIES["box"]
    edge = next(e for e in box.edges_unique if np.ptp(box.vertices[e], axis=0).tolist().count(0) == 2)
    vertices = np.concatenate([box.vertices, box.vertices[edge] * 2])
    fin = np.array([[edge[0], edge[1], 8], [edge[1], 9, 8]])
    mesh = mend(vertices, np.concatenate([box.faces, fin, fin[:, ::-1]]).astype(np.int64))
    assert len(mesh.faces) == len(box.faces) + 2


def test_flat_triangles_on_a_common_side_leave_no_hole() -> None:
    """Two neighbors with a third corner on their common side, each cut into a triangle without area and the rest."""
    box = BODIES["box"]
    faces = np.array(box.faces, np.int64)
    a, b = box.edges_unique[0]
    flat = np.array([[a, len(box.vertices), b], [b, len(box.vertices), a]])
    vertices = np.concatenate([box.vertices, [(box.vertices[a] + box.vertices[b]) / 2]])
    mesh = mend(vertices, np.concatenate([faces, flat]))
    assert mesh.is_watertight and mesh.crowded_edges == 0 and mesh.volume == pytest.approx(box.volume)


def test_a_cavity_is_no_piece() -> None:
    inner = BODIES["box"].copy().apply_scale(0.5)
    inner.invert()
    assert mended(trimesh.util.concatenate([BODIES["box"], inner])).components == 1
