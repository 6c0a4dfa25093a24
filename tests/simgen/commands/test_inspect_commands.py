"""`simgen object`, `preview` and `verify` as a user types them."""

from __future__ import annotations

import json
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result

from evalkit.commands.group import Commands
from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_folder import shard_name
from evalkit.datasets.shard_format import INSTANCE_DTYPES, INSTANCE_FIELDS, INSTANCE_SHAPES, ShardHeader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.commands.inspect_commands import object_command, preview_command, verify_command
from simgen.objects import prepare as meshes

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)


@click.group(cls=Commands)
def simgen() -> None:
    """The three commands alone."""


for command in (object_command, preview_command, verify_command):
    simgen.add_command(command)


def typed(*words: object) -> Result:
    return CliRunner().invoke(simgen, [str(word) for word in words])


@pytest.fixture
def brick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(meshes, "convex_parts", lambda vertices, faces: ([(vertices, faces.astype(np.int32))], []))
    trimesh.creation.box((50, 80, 120)).export(tmp_path / "brick.stl")
    return tmp_path / "brick.stl"


@pytest.fixture
def shards(tmp_path: Path) -> Path:
    """Two frames without instances."""
    model = ObjectModel.from_mesh(
        "box", *(getattr(trimesh.creation.box((0.1, 0.1, 0.1)), n) for n in ("vertices", "faces"))
    )
    nobody = Instances(
        *(np.zeros((0, *INSTANCE_SHAPES.get(name, ())), INSTANCE_DTYPES[name]) for name in INSTANCE_FIELDS)
    )
    depth = np.full((48, 64), 4000, np.uint16)
    folder = tmp_path / "shards"
    with ShardWriter(folder / shard_name(0), ShardHeader(CAMERA, 1e-4, model), 2) as writer:
        for view in range(2):
            writer.append(View(CAMERA, depth, 1e-4, np.zeros_like(depth), np.eye(4), nobody, 0, view))
    return folder


def test_object_prints_units_size_soundness_symmetry_and_parts(brick: Path) -> None:
    done = typed("object", brick)
    assert done.exit_code == 0, done.output
    for words in ("mm: its largest side is 120", "50 x 80 x 120 mm", "watertight, 480 cm3", "8 vertices, 12 faces"):
        assert words in done.output
    assert "dihedral:2 about" in done.output and "residual" in done.output and "% of the diameter" in done.output
    assert "times the tolerance" in done.output or "holds" in done.output
    assert "convex parts: 1" in done.output


def test_object_as_json_says_the_same(brick: Path) -> None:
    document = json.loads(typed("object", brick, "--json").stdout)
    assert document["size_mm"] == pytest.approx([50, 80, 120])
    assert document["notes"]["units"] == "mm" and document["watertight"] is True
    assert document["volume_cm3"] == pytest.approx(480)
    assert document["symmetry"]["name"] == "dihedral:2"
    assert document["symmetry_tried"][0]["times_tolerance"] <= 1
    assert document["convex_volume_over_mesh"] == pytest.approx(1)
    assert document["warnings"] == []


def test_object_options_reach_the_object(brick: Path) -> None:
    done = typed("object", brick, "--units", "m", "--scale", 0.01, "--symmetry", "none", "--json")
    document = json.loads(done.stdout)
    assert document["size_mm"] == pytest.approx([500, 800, 1200])
    assert document["symmetry"]["name"] == "none" and document["symmetry_tried"] == []


def test_object_draws_a_picture(brick: Path, tmp_path: Path) -> None:
    done = typed("object", brick, "-o", tmp_path / "brick.png")
    assert done.exit_code == 0, done.output
    picture = cv2.imread(str(tmp_path / "brick.png"))
    assert picture.shape[0] > 400 and picture.std() > 20


def test_preview_writes_a_page_even_of_frames_without_instances(shards: Path, tmp_path: Path) -> None:
    done = typed("preview", shards, "-o", tmp_path / "page.html")
    assert done.exit_code == 0, done.output
    assert "</html>" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_preview_draws_a_picture(shards: Path, tmp_path: Path) -> None:
    done = typed("preview", shards, "-o", tmp_path / "sheet.png", "--frames", 2)
    assert done.exit_code == 0, done.output
    assert "sheet.png" in done.output
    assert cv2.imread(str(tmp_path / "sheet.png")) is not None


def test_verify_is_content_with_sound_shards(shards: Path) -> None:
    done = typed("verify", shards)
    assert done.exit_code == 0, done.output
    assert "1 shards, 1 scenes, 2 frames" in done.output and "all checksums and label laws hold" in done.output


def test_verify_lists_what_is_wrong_and_exits_with_2(shards: Path) -> None:
    path = shards / shard_name(0)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    done = typed("verify", shards)
    assert done.exit_code == 2
    assert "shard-00000.h5: its bytes do not match its checksum" in done.output


WRONG = [
    ("object", "rabbit"),
    ("object", "{brick}", "--units", "foot"),
    ("object", "{brick}", "--scale", "0"),
    ("object", "{brick}", "--symmetry", "round"),
    ("object", "{brick}", "-o", "picture.xyz"),
    ("preview", "{folder}"),
    ("preview", "{folder}/nowhere"),
    ("preview", "{shards}", "--frames", "0"),
    ("preview", "{shards}", "-o", "sheet.txt"),
    ("verify", "{folder}"),
    ("verify", "{brick}"),
]


@pytest.mark.parametrize("words", WRONG, ids=" ".join)
def test_wrong_input_gets_one_sentence_and_exit_code_2(
    words: tuple[str, ...], brick: Path, shards: Path, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    done = typed(*(word.format(brick=brick, shards=shards, folder=tmp_path / "empty") for word in words))
    assert done.exit_code == 2
    assert "Traceback" not in done.output
    if words[0] != "verify":
        assert done.stderr.startswith("Error: ") and done.stderr.count("\n") == 1


def test_a_built_in_object_becomes_a_mesh_file_that_is_read_as_the_same_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(meshes, "convex_parts", lambda vertices, faces: ([(vertices, faces.astype(np.int32))], []))
    builtin = meshes.prepare_object("bracket").model
    for suffix in (".ply", ".stl", ".obj"):
        done = typed("object", "bracket", "-o", tmp_path / f"bracket{suffix}")
        assert done.exit_code == 0, done.output
        assert f"Next: simgen build --object {tmp_path / 'bracket'}{suffix}" in done.stderr
        model = meshes.prepare_object(str(tmp_path / f"bracket{suffix}")).model
        assert (model.name, model.symmetry.name) == (builtin.name, builtin.symmetry.name)
        np.testing.assert_allclose([model.diameter, *model.centroid], [builtin.diameter, *builtin.centroid], atol=1e-6)


def test_a_mesh_file_that_is_not_there_is_the_built_in_object_of_its_name_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(meshes, "convex_parts", lambda vertices, faces: ([(vertices, faces.astype(np.int32))], []))
    monkeypatch.chdir(tmp_path)
    taken = meshes.prepare_object("bracket.ply")
    assert taken.model.diameter == meshes.prepare_object("bracket").model.diameter
    assert "bracket.ply: no such file" in taken.warnings[0]
    trimesh.creation.box((50, 80, 120)).export(tmp_path / "bracket.ply")
    there = meshes.prepare_object("bracket.ply")
    assert there.model.diameter != taken.model.diameter
    for absent in ("part.ply", "bracket.txt"):
        with pytest.raises(InputError, match=f"{absent}: no such file"):
            meshes.prepare_object(absent)
