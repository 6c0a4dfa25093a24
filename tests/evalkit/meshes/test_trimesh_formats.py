"""STL, glTF and STEP: what trimesh reads right stays right, what it passes over in silence is mended or refused."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from evalkit.meshes import trimesh_formats
from evalkit.meshes.read import read_file_mesh, read_mesh

BOX = trimesh.creation.box((40, 20, 10))
STEP_BOX = Path(__file__).with_name("box_inch.step")  # 1.5 x 1 x 0.5 inches, written by Open CASCADE
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def volume(path: Path) -> float:
    return float(trimesh.Trimesh(*read_mesh(path), process=False).volume)


@pytest.mark.parametrize("tail", [b"", b"\0" * 37, b"\0" * 50, b"made by hand\n"])
@pytest.mark.parametrize("header", [b"", b"solid by name only", b"COLOR=\1\2\3\4"])
def test_bytes_after_the_last_triangle_of_a_binary_stl_do_no_harm(tmp_path: Path, tail: bytes, header: bytes) -> None:
    data = trimesh.exchange.stl.export_stl(BOX)
    (tmp_path / "box.stl").write_bytes(header.ljust(80, b"\0") + data[80:] + tail)
    assert volume(tmp_path / "box.stl") == pytest.approx(8000)


def ascii_stl(name: str, body: trimesh.Trimesh = BOX) -> str:
    text = trimesh.exchange.stl.export_stl_ascii(body)
    return f"solid {name}\n" + text.partition("\n")[2].rstrip() + f" {name}\n"


@pytest.mark.parametrize("name", ["", "box", "vertex plate", "endsolid facet normal 5", "Körper", "solid\tsolid"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("capitals", [False, True])
def test_every_solid_of_a_text_stl_is_read_whatever_its_name(
    tmp_path: Path, name: str, line_end: str, capitals: bool
) -> None:
    text = ascii_stl(name) + ascii_stl(name, BOX.copy().apply_translation([100, 0, 0]))
    text = (text.upper() if capitals else text).replace("\n", line_end)
    (tmp_path / "two.stl").write_bytes(text.encode())
    assert volume(tmp_path / "two.stl") == pytest.approx(16_000)


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: text + text[: len(text) // 2],
        lambda text: text.replace("20.0", "x", 1) if "20.0" in text else text.replace("10.0", "x", 1),
        lambda text: text.replace("vertex", "point", 3),
        lambda text: text.replace("0.5", "0,5").replace("10.0", "10,0"),
    ],
)
def test_a_damaged_text_stl_is_refused_and_never_read_in_part(tmp_path: Path, damage: Callable[[str], str]) -> None:
    (tmp_path / "bad.stl").write_text(damage(ascii_stl("box")))
    with pytest.raises(InputError, match=r"bad\.stl: .*export"):
        read_mesh(tmp_path / "bad.stl")


def test_a_truncated_binary_stl_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_bytes(trimesh.exchange.stl.export_stl(BOX)[:-30])
    with pytest.raises(InputError, match=r"bad\.stl"):
        read_mesh(tmp_path / "bad.stl")


@pytest.mark.parametrize("extension", ["glb", "gltf"])
def test_instances_stand_where_the_scene_puts_them_mirrored_ones_wound_outwards(tmp_path: Path, extension: str) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(BOX, node_name="first", geom_name="box")
    away = trimesh.transformations.translation_matrix([100, 0, 0])
    scene.graph.update("second", "first", matrix=away @ MIRROR, geometry="box")
    scene.graph.update("third", "second", matrix=away @ np.diag([2.0, 2, 2, 1]), geometry="box")
    if extension == "glb":
        scene.export(tmp_path / "scene.glb")
    else:
        for name, content in scene.export(file_type="gltf").items():
            (tmp_path / name.replace("model.gltf", "scene.gltf")).write_bytes(content)
    mesh = read_file_mesh(tmp_path / f"scene.{extension}")
    assert mesh.unit == "m"
    assert volume(tmp_path / f"scene.{extension}") == pytest.approx(8000 * (1 + 1 + 8), rel=1e-6)
    assert np.sort(mesh.vertices[:, 0])[[0, -1]] == pytest.approx([-40, 120])


def glb_with(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    data = BOX.export(file_type="glb")
    (length,) = struct.unpack_from("<I", data, 12)
    header = json.loads(data[20 : 20 + length])
    change(header)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    path.write_bytes(data[:8] + struct.pack("<III", 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest)
    return path


def primitive(header: dict[str, Any]) -> dict[str, Any]:
    return header["meshes"][0]["primitives"][0]


def positions(header: dict[str, Any]) -> dict[str, Any]:
    return header["accessors"][primitive(header)["attributes"]["POSITION"]]


REFUSED: dict[str, Callable[[dict[str, Any]], None]] = {
    "KHR_draco_mesh_compression": lambda h: h.update(extensionsRequired=["KHR_draco_mesh_compression"]),
    "EXT_meshopt_compression": lambda h: h.update(extensionsRequired=["EXT_meshopt_compression"]),
    "fans": lambda h: primitive(h).update(mode=6),
    "sparse": lambda h: positions(h).update(sparse={"count": 1}),
    "normalized": lambda h: positions(h).update(normalized=True),
    "EXT_mesh_gpu_instancing": lambda h: h["nodes"][-1].update(extensions={"EXT_mesh_gpu_instancing": {}}),
    "skinned": lambda h: [node.update(skin=0) for node in h["nodes"] if "mesh" in node] and None,
}


@pytest.mark.parametrize("word", REFUSED)
def test_gltf_that_would_be_read_wrong_is_refused_by_the_name_of_the_reason(tmp_path: Path, word: str) -> None:
    with pytest.raises(InputError, match=rf"a\.glb: .*{word}.*export"):
        read_mesh(glb_with(tmp_path / "a.glb", REFUSED[word]))


def test_materials_and_textures_do_not_matter(tmp_path: Path) -> None:
    path = glb_with(tmp_path / "a.glb", lambda h: h.update(extensionsRequired=["KHR_materials_unlit"]))
    assert volume(path) == pytest.approx(8000)


def test_step_comes_in_meters_whatever_its_unit() -> None:
    pytest.importorskip("cascadio")
    mesh = read_file_mesh(STEP_BOX)
    assert mesh.unit == "m"
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), np.array([1.5, 1.0, 0.5]) * 0.0254, rtol=1e-6)
    assert volume(STEP_BOX) == pytest.approx(0.75 * 0.0254**3, rel=1e-6)


def test_damaged_step_files_are_refused_or_read_and_nothing_is_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cascadio")
    whole, rng = STEP_BOX.read_bytes(), np.random.default_rng(0)
    for trial in range(4):
        damaged = bytearray(whole[: len(whole) // (1 + trial % 2)])
        for i in rng.integers(0, len(damaged), 60 * trial):
            damaged[i] = int(rng.integers(32, 127))
        (tmp_path / "bad.stp").write_bytes(bytes(damaged))
        try:
            assert np.isfinite(read_mesh(tmp_path / "bad.stp")[0]).all()
        except InputError as error:
            assert "bad.stp" in str(error)
    assert "".join(capfd.readouterr()) == ""


def test_step_without_its_extra_gets_the_line_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trimesh_formats, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"box_inch\.step: .*pip install 'binpose-evalkit\[step\]'"):
        read_mesh(STEP_BOX)
