"""Foreign things among the parts: they hide parts, have no labels, and lie on what is there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from numpy.typing import NDArray

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry import poses
from simgen.building.verify import verify_shards
from simgen.commands.cli import cli
from simgen.commands.options import configured
from simgen.config_json import config_from_json
from simgen.config_sections import BinSize, DistractorConfig
from simgen.objects.foreign_things import MOST_FACES, Thing, parse_distractors, things_of
from simgen.presets import debug, domestic
from simgen.scenes.distractors import put_distractors

SIZE = BinSize(0.4, 0.3, 0.1)
BUILTIN = DistractorConfig(("builtin",), ("",), 0.3)
PART = trimesh.creation.box((0.08, 0.06, 0.05))
MESH = (np.asarray(PART.vertices), np.asarray(PART.faces, np.int32))


def lying(count: int) -> NDArray[np.float64]:
    """Parts (count, 4, 4) beside each other on the floor."""
    x = np.linspace(-0.15, 0.15, count)
    return poses.from_rotation_translation(
        np.broadcast_to(np.eye(3), (count, 3, 3)), np.column_stack([x, 0 * x, 0 * x + 0.025])
    )


@pytest.fixture(scope="module")
def things() -> list[Thing]:
    return things_of(BUILTIN, "cup", 0.1)


def test_the_built_in_things_suit_the_part_and_the_part_is_not_among_them(things: list[Thing]) -> None:
    names = {thing.name for thing in things}
    assert "cup" not in names and {"gear", "gripper finger", "cable 0", "crumpled sheet 1"} <= names
    for thing in things:
        extent = np.linalg.norm(np.ptp(thing.vertices, axis=0))
        assert 0.02 < extent < 0.35 and 0 < len(thing.faces) <= 1.2 * MOST_FACES, thing.name
        assert thing.faces.max() < len(thing.vertices) and np.isfinite(thing.vertices).all()
    larger = things_of(BUILTIN, "cup", 0.2)
    assert np.allclose(2 * np.ptp(things[-1].vertices, axis=0), np.ptp(larger[-1].vertices, axis=0))


def test_as_many_things_lie_there_as_their_share_says(things: list[Thing]) -> None:
    counts = [len(put_distractors(things, 0.3, MESH, lying(7), SIZE, 0.1, seed=1, scene=i)) for i in range(60)]
    assert np.mean(counts) == pytest.approx(3.0, rel=0.25) and np.std(counts) > 0.5


def test_things_touch_what_is_there_and_stand_in_nothing(things: list[Thing]) -> None:
    board = Thing("board", PART.vertices * (1.0, 1.0, 0.2), MESH[1], upright=True, scalable=False)
    middle = lying(3)[1:2]
    for scene in range(10):
        for vertices, _ in put_distractors([board], 0.5, MESH, middle, replace(SIZE, walls=False), 0.1, 0, scene)[:1]:
            above_part = (np.abs(vertices[:, :2].mean(0)) < 0.02 + np.array([0.04, 0.03])).all()
            bottom = vertices[:, 2].min()
            assert bottom == pytest.approx(0.05, abs=1e-3) if above_part else bottom > -1e-9
    for scene in range(5):
        for vertices, _ in put_distractors(things, 0.5, MESH, lying(4), SIZE, 0.1, 0, scene):
            assert vertices[:, 2].min() > -1e-6 and vertices[:, 2].max() < SIZE.height + 0.12 + 1e-9


def test_a_scenes_things_are_its_own(things: list[Thing]) -> None:
    def bits(seed: int, scene: int) -> bytes:
        put = put_distractors(things, 0.5, MESH, lying(4), SIZE, 0.1, seed, scene)
        return b"".join(vertices.tobytes() for vertices, _ in put)

    assert bits(3, 1) == bits(3, 1) and bits(3, 1) != bits(3, 2) and bits(3, 1) != bits(4, 1)


def build(out: Path, *arguments: object, code: int = 0) -> str:
    words = ["build", "--object", "brick", "--preset", "debug", "--scenes", 2, "--workers", 1, "-o", out]
    result = CliRunner().invoke(cli, [str(word) for word in (*words, *arguments)])
    assert result.exit_code == code, result.output
    return result.output


def test_distractors_hide_parts_and_leave_every_other_label_as_it_was(tmp_path: Path) -> None:
    build(tmp_path / "alone")
    output = build(tmp_path / "among", "--distractors", "builtin", "--share", 0.6)
    assert "Distractors: 60% of all that lies there, of builtin" in output
    assert verify_shards(tmp_path / "among").problems == []
    hidden = nearer = 0
    for alone, among in zip(ShardDataset(tmp_path / "alone"), ShardDataset(tmp_path / "among"), strict=True):
        assert np.array_equal(alone.instances.cam_from_obj, among.instances.cam_from_obj)
        assert np.array_equal(alone.instances.pixels_full, among.instances.pixels_full)
        assert (among.instances.pixels_geometric <= alone.instances.pixels_geometric).all()
        assert set(np.unique(among.instance_id)) <= set(np.unique(alone.instance_id))
        changed = alone.depth_raw != among.depth_raw
        assert (among.depth_raw[changed] < alone.depth_raw[changed]).all(), "things only come before what was there"
        assert (among.instance_id[changed] == 0).all()
        hidden += int((alone.instances.pixels_geometric - among.instances.pixels_geometric).sum())
        nearer += int(changed.sum())
    assert hidden > 50 and nearer > 500
    build(tmp_path / "again", "--distractors", "builtin", "--share", 0.6, "--workers", 2)
    for shard in sorted((tmp_path / "among").glob("*.h5")):
        assert shard.read_bytes() == (tmp_path / "again" / shard.name).read_bytes()


def test_files_are_distractors_too_and_must_stay_what_they_were(tmp_path: Path) -> None:
    path = tmp_path / "other.stl"
    trimesh.creation.cylinder(15.0, 60.0).export(path)  # millimeters
    config = parse_distractors(f"{path},builtin", 0.2)
    found = things_of(config, "brick", 0.1)
    assert found[0].name == "other" and np.ptp(found[0].vertices, axis=0) == pytest.approx([0.03, 0.03, 0.06], rel=0.01)
    assert len(found) == 1 + len(things_of(BUILTIN, "brick", 0.1))
    trimesh.creation.box((10.0, 10.0, 10.0)).export(path)
    with pytest.raises(InputError, match=r"other\.stl: the file is missing or has changed"):
        things_of(config, "brick", 0.1)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--distractors", "nowhere.stl"), "--distractors nowhere.stl: no such file"),
        (("--distractors", ""), "no such file"),
        (("--distractors", "builtin", "--share", 0), "--share 0"),
        (("--distractors", "builtin", "--share", 1.5), "--share 1.5"),
        (("--distractors", "builtin", "--share", "nan"), "--share nan"),
        (("--share", 0.3), "--share 0.3: of which distractors?"),
        (("--distractors", "none", "--share", 0.3), "of no distractors"),
    ],
)
def test_senseless_distractors_are_refused(arguments: tuple[object, ...], sentence: str, tmp_path: Path) -> None:
    assert sentence in build(tmp_path / "out", *arguments, code=2)
    assert not (tmp_path / "out").exists()


def test_a_config_with_distractors_survives_its_file_and_options_change_it() -> None:
    config = domestic()
    assert config_from_json(config.to_json(), "here") == config and "Distractors: 50%" in config.describe()
    assert configured(config, distractors="none").distractors is None
    assert configured(config, share=0.2).distractors == DistractorConfig(("builtin",), ("",), 0.2)
    assert configured(debug(), distractors="builtin").distractors == BUILTIN
