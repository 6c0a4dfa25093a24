"""Polygons of every format become triangles that cover what the polygons cover."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.poses import random_rotations
from evalkit.meshes.mesh_file_error import MeshFileError
from evalkit.meshes.polygons import Polygons, triangulate
from evalkit.meshes.read import read_mesh

L_SECTION = [(30, 0), (30, 10), (10, 10), (10, 40), (0, 40), (0, 0)]
WITH_STRAIGHT_CORNERS = [(30, 0), (30, 5), (30, 10), (10, 10), (10, 25), (10, 40), (0, 40), (0, 0), (15, 0)]
WITH_A_HOLE = [(0, 0), (10, 0), (10, 10), (0, 10), (0, 0), (3, 3), (3, 7), (7, 7), (7, 3), (3, 3)]  # cut open
ARROW = [(0, 0), (10, 0), (2, 2), (0, 10)]
Outline = list[tuple[float, float]]


def areas(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.cross(b - a, c - a) / 2


def polygons(*faces: list[int]) -> Polygons:
    return Polygons(np.array([len(face) for face in faces]), np.array([i for face in faces for i in face]))


def shoelace(outline: Outline) -> float:
    x, y = np.array(outline, float).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


@pytest.mark.parametrize("start", range(6))
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("outline", [L_SECTION, WITH_STRAIGHT_CORNERS, WITH_A_HOLE, ARROW])
@pytest.mark.parametrize("seed", range(3))
def test_concave_polygons_keep_their_area_their_winding_and_their_edges(
    outline: Outline, start: int, backwards: bool, seed: int
) -> None:
    outline = outline[start % len(outline) :] + outline[: start % len(outline)]
    outline = outline[::-1] if backwards else outline
    turn = random_rotations(np.random.default_rng(seed), 1)[0]
    vertices = np.column_stack([np.array(outline, float), np.zeros(len(outline))]) @ turn.T + [5, -3, 900]
    faces = triangulate(vertices, polygons(list(range(len(outline)))))
    parts = areas(vertices, faces)
    np.testing.assert_allclose(parts.sum(0), turn @ [0, 0, shoelace(outline)], atol=1e-9)
    assert np.linalg.norm(parts, axis=1).sum() == pytest.approx(abs(shoelace(outline)))
    directed = {(a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    rim = {(i, (i + 1) % len(outline)) for i in range(len(outline))}
    assert {edge for edge in directed if edge[::-1] not in directed} == rim  # neighbors still meet edge to edge


@pytest.mark.parametrize("dtype", [float, np.float32])
@pytest.mark.parametrize("between", range(1, 4))
def test_straight_corners_make_no_triangles_without_area(between: int, dtype: type) -> None:
    """A square of 40 with more corners on its sides, as neighbors that are cut finer give it."""
    ends = np.array([(0, 0), (40, 0), (40, 40), (0, 40)], float)
    share = np.arange(between + 1)[:, None] / (between + 1)
    outline = np.concatenate([a + (b - a) * share for a, b in zip(ends, np.roll(ends, -1, 0), strict=True)])
    turn = random_rotations(np.random.default_rng(0), 1)[0]
    vertices = (np.column_stack([outline, 0 * outline[:, 0]]) @ turn.T + 90).astype(dtype).astype(float)
    found = np.linalg.norm(areas(vertices, triangulate(vertices, polygons(list(range(len(outline)))))), axis=1)
    assert len(found) == len(outline) - 2 and found.sum() == pytest.approx(1600)
    assert found.min() > 10


@given(st.integers(5, 12), st.integers(0, 10_000))
def test_star_shaped_outlines_of_any_radii_keep_their_area(corners: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) * 2 * np.pi / corners
    radius = rng.uniform(0.2, 2.0, corners)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(corners, 1.0)], -1)
    faces = triangulate(vertices, polygons(list(range(corners))))
    outline = [(float(x), float(y)) for x, y, _ in vertices]
    assert np.linalg.norm(areas(vertices, faces), axis=1).sum() == pytest.approx(abs(shoelace(outline)))


def test_faces_come_in_the_order_of_their_polygons_and_points_and_lines_are_left_out() -> None:
    angle = np.arange(10) / 2
    vertices = np.stack([np.cos(angle), np.sin(angle), np.zeros(10)], -1)
    faces = triangulate(vertices, polygons([0, 1, 2, 3], [4, 5], [6, 7, 8], [9], [2, 1, 0]))
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [6, 7, 8], [2, 1, 0]]


@pytest.mark.parametrize("outline", [[(0, 0), (10, 10), (10, 0), (0, 9)], [(0, 0), (8, 6), (0, 6), (8, 0), (4, 9)]])
def test_a_polygon_that_crosses_itself_is_refused(outline: Outline) -> None:
    vertices = np.column_stack([np.array(outline, float), np.zeros(len(outline))])
    with pytest.raises(MeshFileError, match="crosses itself"):
        triangulate(vertices, polygons(list(range(len(outline)))))


def prism() -> tuple[NDArray[np.float64], list[list[int]]]:
    """An L section of area 2600 and volume 6000: two concave hexagons and six quads."""
    n = len(L_SECTION)
    vertices = np.array([(x, y, z) for z in (0, 10) for x, y in L_SECTION], float)
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return vertices, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def written(folder: Path, kind: str) -> Path:
    vertices, faces = prism()
    path = folder / f"l.{kind.partition(' ')[0]}"
    rows = ["{:g} {:g} {:g}".format(*v) for v in vertices]
    header = "element vertex 12\nproperty float x\nproperty float y\nproperty float z\nelement face 8\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    lists = [f"{len(f)} {' '.join(map(str, f))}" for f in faces]
    if kind == "obj":
        corners = [" ".join(str(i + 1) for i in face) for face in faces]
        path.write_text("".join(f"v {row}\n" for row in rows) + "".join(f"f {face}\n" for face in corners))
    elif kind == "off":
        path.write_text("\n".join(["OFF", "12 8 0", *rows, *lists]) + "\n")
    elif kind == "ply ascii":
        path.write_text("ply\nformat ascii 1.0\n" + header + "\n".join([*rows, *lists]) + "\n")
    else:
        order, name = (">", "big") if "big" in kind else ("<", "little")
        body = vertices.astype(order + "f4").tobytes()
        body += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
        path.write_bytes(f"ply\nformat binary_{name}_endian 1.0\n{header}".encode() + body)
    return path


@pytest.mark.parametrize("kind", ["obj", "off", "ply ascii", "ply little", "ply big"])
def test_a_prism_with_concave_ends_has_its_area_and_volume_in_every_format_of_polygons(
    tmp_path: Path, kind: str
) -> None:
    vertices, faces = read_mesh(written(tmp_path, kind))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.linalg.norm(areas(vertices, faces), axis=1).sum() == pytest.approx(2600)
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(6000)


def test_the_file_is_named_when_one_of_its_faces_crosses_itself(tmp_path: Path) -> None:
    (tmp_path / "bow.obj").write_text("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 .9 0\nf 1 2 3 4\n")
    with pytest.raises(InputError, match=r"bow\.obj: a face of 4 corners crosses itself.*export"):
        read_mesh(tmp_path / "bow.obj")
