"""Convex parts are convex, follow the mesh, come from the cache where they can, and never fail."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from simgen.objects import convex
from simgen.objects.builtin import candlestick
from simgen.objects.convex import cache_folder, convex_parts

Mesh = tuple[np.ndarray, np.ndarray]
Parts = list[tuple[np.ndarray, np.ndarray]]


def angle_iron(size: float = 0.1) -> Mesh:
    """Two legs at a right angle: its hull has nearly twice its volume."""
    outline = np.array([[0, 0], [1, 0], [1, 0.2], [0.2, 0.2], [0.2, 1], [0, 1]]) * size
    corners = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.3 * size)])
    cap = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    sides = [face for i in range(6) for j in [(i + 1) % 6] for face in ([i, j, j + 6], [i, j + 6, i + 6])]
    faces = [face[::-1] for face in cap] + [[i + 6 for i in face] for face in cap] + sides
    return corners, np.array(faces, np.int64)


def volume(parts: Parts) -> float:
    return sum(trimesh.Trimesh(*part).volume for part in parts)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def parts_of_coacd() -> Parts:
    """What CoACD makes of the angle iron."""
    return convex._decompose(*angle_iron())


@pytest.fixture
def computed(parts_of_coacd: Parts, monkeypatch: pytest.MonkeyPatch) -> list[Mesh]:
    """The meshes that were decomposed, which takes no time here."""
    calls: list[Mesh] = []

    def decompose(vertices: np.ndarray, faces: np.ndarray) -> Parts:
        calls.append((vertices, faces))
        return parts_of_coacd

    monkeypatch.setattr(convex, "_decompose", decompose)
    return calls


def same(first: Parts, second: Parts) -> bool:
    pairs = [pair for one, other in zip(first, second, strict=True) for pair in zip(one, other, strict=True)]
    return all(np.array_equal(one, other) for one, other in pairs)


def test_parts_are_convex_and_follow_the_mesh(parts_of_coacd: Parts) -> None:
    assert len(parts_of_coacd) > 1
    for points, triangles in parts_of_coacd:
        part = trimesh.Trimesh(points, triangles)
        assert part.is_watertight and part.is_convex
    solid = trimesh.Trimesh(*angle_iron())
    assert volume(parts_of_coacd) == pytest.approx(solid.volume, rel=0.15)
    assert solid.convex_hull.volume > 1.5 * volume(parts_of_coacd)


def test_computed_twice_the_parts_are_the_same_and_nothing_is_printed(
    parts_of_coacd: Parts, capfd: pytest.CaptureFixture[str]
) -> None:
    parts, warnings = convex_parts(*angle_iron())
    assert same(parts, parts_of_coacd) and warnings == []
    assert "".join(capfd.readouterr()) == ""


def test_parts_grow_with_the_object(parts_of_coacd: Parts) -> None:
    large, _ = convex_parts(*angle_iron(25.0))
    assert [len(points) for points, _ in large] == [len(points) for points, _ in parts_of_coacd]
    assert volume(large) == pytest.approx(volume(parts_of_coacd) * 250**3, rel=1e-3)


def test_parts_are_computed_once_a_mesh(computed: list[Mesh]) -> None:
    first, _ = convex_parts(*angle_iron())
    second, warnings = convex_parts(*angle_iron())
    assert same(first, second) and warnings == []
    assert len(computed) == 1
    convex_parts(*angle_iron(0.2))
    assert len(computed) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nothing of the kind", "half", "pickle", "vertices"])
def test_a_damaged_cache_is_computed_anew(damage: bytes | str, computed: list[Mesh]) -> None:
    parts, _ = convex_parts(*angle_iron())
    (path,) = cache_folder().iterdir()
    whole = path.read_bytes()
    if isinstance(damage, bytes):
        path.write_bytes(damage)
    elif damage == "half":
        path.write_bytes(whole[: len(whole) // 2])
    else:
        vertices = np.array([{}], dtype=object) if damage == "pickle" else np.eye(3)
        with open(path, "wb") as file:
            np.savez(file, vertices_0=vertices, faces_0=np.array([[0, 1, 7]]))
    again, warnings = convex_parts(*angle_iron())
    assert same(parts, again) and warnings == []
    assert len(computed) == 2
    assert path.read_bytes() == whole


def test_a_cache_that_cannot_be_written_is_told_and_done_without(cache: Path, computed: list[Mesh]) -> None:
    cache.write_text("a file where a folder should be")
    parts, warnings = convex_parts(*angle_iron())
    assert len(parts) > 1
    assert len(warnings) == 1 and "XDG_CACHE_HOME" in warnings[0]


def crash(*_: object, **__: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.CompletedProcess([], -11)


@pytest.mark.parametrize("signal", [9, 15, 24])
def test_where_coacd_is_stopped_nothing_stands_in_for_its_parts(signal: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: subprocess.CompletedProcess([], -signal))
    with pytest.raises(InputError, match=rf"signal {signal}.*decimate"):
        convex_parts(*angle_iron())
    assert not cache_folder().exists()


def test_no_time_on_the_clock_ends_coacd(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, object]] = []
    monkeypatch.setattr(subprocess, "run", lambda *_, **options: asked.append(options) or crash())
    convex_parts(*angle_iron())
    assert "timeout" not in asked[0]


def test_where_coacd_crashes_the_hull_stands_in_and_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", crash)
    vertices, faces = angle_iron()
    parts, warnings = convex_parts(vertices, faces)
    assert len(parts) == 1
    assert volume(parts) == pytest.approx(trimesh.Trimesh(vertices, faces).convex_hull.volume)
    assert len(warnings) == 1 and "convex hull" in warnings[0]
    assert not cache_folder().exists()


def test_open_and_fine_meshes_are_simplified_for_coacd() -> None:
    ball = trimesh.creation.icosphere(5)
    simple = convex._simplified(np.array(ball.vertices), np.array(ball.faces, np.int64)[100:])
    assert len(simple.faces) <= 2 * convex.MAX_FACES
    assert simple.volume == pytest.approx(ball.volume, rel=0.02)


def test_simplifying_keeps_thin_parts() -> None:
    fine = trimesh.Trimesh(*candlestick(), process=False).subdivide().subdivide()
    simple = convex._simplified(np.array(fine.vertices), np.array(fine.faces, np.int64))
    assert len(simple.faces) < len(fine.faces) / 2
    assert simple.is_watertight
    assert simple.area == pytest.approx(fine.area, rel=0.01)
    assert np.abs(simple.bounds - fine.bounds).max() < 0.005 * np.ptp(fine.bounds, axis=0).max()


def test_the_parts_of_a_ball_hold_its_surface_within_half_a_percent() -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    parts, warnings = convex_parts(np.array(ball.vertices), np.array(ball.faces, np.int64))
    assert warnings == []
    hulls = [trimesh.Trimesh(*part).convex_hull for part in parts]
    outside = [
        (ball.vertices @ hull.face_normals.T - (hull.triangles_center * hull.face_normals).sum(1)).max(1)
        for hull in hulls
    ]
    assert np.min(outside, axis=0).max() < 0.005 * 0.1
    assert volume(parts) == pytest.approx(ball.volume, rel=0.02)


@pytest.mark.parametrize("radius", [0.2, 0.03, 0.01, 0.003])
def test_hulls_of_thin_parts_keep_their_section(radius: float) -> None:
    """Of rods of unit length: a tolerance of the length alone would make the thinnest half as thick again."""
    rod = trimesh.creation.cylinder(radius, 1.0, sections=64)
    points, triangles = convex._simplified_part((np.array(rod.vertices), np.array(rod.faces)))
    assert np.ptp(points[:, :2], axis=0) == pytest.approx(2 * radius, rel=0.1)
    assert trimesh.Trimesh(points, triangles).volume == pytest.approx(rod.volume, rel=0.1)
