"""Every mesh format is read, and whatever is no mesh gets one sentence."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from evalkit.meshes.read import FORMATS, read_mesh

WEDGE = trimesh.convex.convex_hull(np.random.default_rng(0).normal(size=(30, 3)))
ONE_TRIANGLE_PLY = """ply
format ascii 1.0
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""


def ascii_ply(path: Path, vertices: str, faces: str) -> Path:
    header = ONE_TRIANGLE_PLY.format(vertices=vertices.count(";") + 1, faces=faces.count(";") + 1)
    body = "\n".join(line.strip() for line in f"{vertices};{faces}".split(";"))
    path.write_text(header + body + "\n")
    return path


@pytest.mark.parametrize("extension", ["ply", "stl", "obj", "off", "glb"])
def test_every_format_holds_the_same_body(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"wedge.{extension}"
    WEDGE.export(path)
    mesh = trimesh.Trimesh(*read_mesh(path))
    assert len(mesh.vertices) == len(WEDGE.vertices)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(WEDGE.volume, rel=1e-5)


def test_capitals_in_the_extension_do_not_matter(tmp_path: Path) -> None:
    WEDGE.export(tmp_path / "wedge.stl")
    (tmp_path / "wedge.stl").rename(tmp_path / "WEDGE.STL")
    assert len(read_mesh(tmp_path / "WEDGE.STL")[1]) == len(WEDGE.faces)


def broken_files(folder: Path) -> dict[str, Path]:
    """One file of each kind that is no mesh, by what is wrong."""
    WEDGE.export(folder / "whole.stl")
    (folder / "truncated.stl").write_bytes((folder / "whole.stl").read_bytes()[:-100])
    WEDGE.export(folder / "whole.glb")
    (folder / "truncated.glb").write_bytes((folder / "whole.glb").read_bytes()[:-100])
    (folder / "empty.ply").write_bytes(b"")
    (folder / "empty.glb").write_bytes(b"")
    (folder / "prose.off").write_text("This is not a mesh.\n")
    (folder / "prose.gltf").write_text('{"asset": 5}')
    (folder / "claims.stl").write_bytes(b"\0" * 80 + (4_000_000_000).to_bytes(4, "little") + b"\0" * 500)
    (folder / "prose.ply").write_text("This is not a mesh.\n")
    (folder / "prose.stl").write_text("solid nothing\nendsolid nothing\n")
    (folder / "prose.obj").write_text("# nothing here\n")
    (folder / "mesh.txt").write_text("v 0 0 0")
    (folder / "off-index.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    (folder / "folder.ply").mkdir()
    trimesh.PointCloud(np.eye(3)).export(folder / "points.ply")
    ascii_ply(folder / "nan.ply", "0 0 0; nan 0 0; 0 1 0; 0 0 1", "3 0 1 2; 3 0 2 3")
    ascii_ply(folder / "infinite.ply", "0 0 0; inf 0 0; 0 1 0; 0 0 1", "3 0 1 2; 3 0 2 3")
    return {path.name: path for path in folder.iterdir() if not path.name.startswith("whole")} | {
        "missing.ply": folder / "missing.ply"
    }


def test_what_is_no_mesh_gets_one_sentence_that_names_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    for name, path in broken_files(tmp_path).items():
        with pytest.raises(InputError) as error:
            read_mesh(path)
        sentence = str(error.value)
        assert name in sentence, sentence
        assert sentence.endswith(".") and "\n" not in sentence and "Traceback" not in sentence, sentence
        assert not any(words in sentence for words in ("module named", "attribute", "out of bounds", "unpack")), (
            sentence
        )
    assert not caplog.records
    assert "".join(capfd.readouterr()) == ""


@pytest.mark.parametrize("extension", [name for name in FORMATS if name not in ("step", "stp", "3mf")])
def test_arbitrary_bytes_never_raise_anything_else(tmp_path: Path, extension: str) -> None:
    WEDGE.export(tmp_path / "whole.glb" if extension == "gltf" else tmp_path / f"whole.{extension}")
    whole = next(tmp_path.glob("whole.*")).read_bytes()
    rng = np.random.default_rng(1)
    for trial in range(25):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(damaged), 1 + trial):
            damaged[place] = int(rng.integers(256))
        path = tmp_path / f"damaged.{extension}"
        path.write_bytes(bytes(damaged[: rng.integers(1, len(damaged))] if trial % 2 else damaged))
        try:
            vertices, faces = read_mesh(path)
        except InputError:
            continue
        assert len(faces) > 0 and faces.max() < len(vertices)
        assert np.isfinite(vertices[faces]).all()


def test_commands_that_read_no_mesh_do_not_wait_for_the_mesh_libraries() -> None:
    code = "import sys, evalkit.commands.cli, evalkit.meshes.load; print({'trimesh', 'manifold3d'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "set()", done.stderr
