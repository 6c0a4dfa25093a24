"""Damage is found, named, and mended to the byte, from the folder alone."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from evalkit.datasets.shard_folder import DATASET_FILE, shard_name
from evalkit.errors import InputError
from simgen.building.build import build
from simgen.building.repair import repair
from simgen.commands.cli import cli
from simgen.objects.prepare import prepare_object
from simgen.physics.distribution import bullet_version
from simgen.presets import debug
from simgen.scenes.plan import plan
from simgen.scenes.software import software_here


def verify(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["verify", *map(str, arguments)])


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three shards of one scene."""
    folder = tmp_path_factory.mktemp("built") / "shards"
    prepared = prepare_object("brick")
    config = replace(debug(), scenes=3, views=1, shard_scenes=1)
    build(plan(config, prepared.model, prepared.convex_parts), folder, workers=1)
    return folder


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "copy"))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip_a_bit(path: Path) -> None:
    spoiled = bytearray(path.read_bytes())
    spoiled[len(spoiled) // 2] ^= 4
    path.write_bytes(spoiled)


def test_damaged_and_missing_shards_are_named_and_rebuilt_to_the_byte(built: Path, copy: Path) -> None:
    truncate(copy / shard_name(0))
    flip_a_bit(copy / shard_name(2))
    found = verify(copy)
    assert found.exit_code == 2
    assert f"{shard_name(0)}: " in found.stderr and f"{shard_name(2)}: " in found.stderr
    assert f"{shard_name(1)}: " not in found.stderr
    assert "'simgen verify --repair" in found.stderr
    (copy / shard_name(0)).unlink()
    mended = verify(copy, "--repair", "--workers", "1")
    assert mended.exit_code == 0, mended.output
    assert f"{shard_name(0)} was missing and has been rebuilt." in mended.output
    assert f"{shard_name(2)} was damaged and has been rebuilt." in mended.output
    assert "all checksums and label laws hold" in mended.output
    assert contents(copy) == contents(built)


def test_where_every_shard_is_damaged_the_object_is_read_from_what_is_left(built: Path, copy: Path) -> None:
    for shard in range(3):
        path = copy / shard_name(shard)
        spoiled = bytearray(path.read_bytes())
        spoiled[100] ^= 1  # in the checksum's own block
        path.write_bytes(spoiled)
        flip_a_bit(path) if shard else path.write_bytes(spoiled[:40] + b"0000" + spoiled[44:])
    assert verify(copy, "--repair", "--workers", "1").exit_code == 0
    assert contents(copy) == contents(built)


def test_a_sound_dataset_is_left_alone(copy: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in copy.iterdir()}
    result = verify(copy, "--repair")
    assert result.exit_code == 0 and "rebuilt" not in result.output
    assert {path.name: path.stat().st_mtime_ns for path in copy.iterdir()} == before


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda d: d["config"].update(geometry_sha256="0" * 64), "come out differently here"),
        (lambda d: d["config"].update(layouts={"format": "sileane"}), "its scenes were not simulated here"),
        (lambda d: d["config"].pop("views"), "the field 'views' is missing"),
    ],
)
def test_what_the_folder_alone_cannot_mend_is_said(copy: Path, spoil: Callable[[dict], object], sentence: str) -> None:
    document = json.loads((copy / DATASET_FILE).read_text())
    spoil(document)
    (copy / DATASET_FILE).write_text(json.dumps(document))
    before = contents(copy)
    result = verify(copy, "--repair")
    assert result.exit_code == 2 and sentence in result.stderr.splitlines()[-1]
    assert contents(copy) == before


def test_a_folder_without_readable_shards_and_a_single_file_are_refused(copy: Path) -> None:
    truncate(copy / shard_name(0))
    result = verify(copy / shard_name(0), "--repair")
    assert result.exit_code == 2 and "--repair needs the folder" in result.stderr
    for shard in range(3):
        (copy / shard_name(shard)).write_bytes(b"gone")
    result = verify(copy, "--repair")
    assert result.exit_code == 2 and "no shard is left to read the object from" in result.stderr


def test_any_flipped_bit_is_reported_as_a_problem_and_crashes_nothing(copy: Path) -> None:
    path, rng = copy / shard_name(1), np.random.default_rng(0)
    sound = path.read_bytes()
    for number in range(24):
        spoiled = bytearray(sound)
        place = int(rng.integers(512, 4096 if number % 2 else len(sound)))
        spoiled[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoiled)
        result = verify(path)
        assert result.exit_code == 2 and f"{shard_name(1)}" in result.stderr, (place, result.output)
        assert result.exception is None or isinstance(result.exception, SystemExit)


def test_software_that_differs_either_way_is_named(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = {name: version for name, version in software_here("pybullet").items() if name != "h5py"} | {"another": "9.9"}
    monkeypatch.setattr("simgen.building.repair.software_here", lambda _: here)
    _, warnings = repair(copy, workers=1)
    assert [warning.split(":")[0] for warning in warnings] == [
        "another (none) made the dataset, 9.9 is here",
        f"h5py {version('h5py')} made the dataset, (none) is here",
    ]


def test_a_dataset_of_the_first_schema_is_left_as_it_is_and_never_completed_with_the_second(
    copy: Path, as_schema_1: Callable[[Path], None]
) -> None:
    as_schema_1(copy)
    before = contents(copy)
    report, _ = repair(copy, workers=1)
    assert report.written == [] and report.kept == 3 and contents(copy) == before
    assert verify(copy).exit_code == 0
    (copy / shard_name(1)).unlink()
    before = contents(copy)
    result = verify("--repair", copy)
    assert result.exit_code == 2 and result.stderr.count("Error: ") == 1
    assert "begun with shards of schema binpose-shard/1" in result.stderr
    assert contents(copy) == before
    older = json.loads((copy / DATASET_FILE).read_text(encoding="utf-8"))
    del older["config"]["physics"]
    (copy / DATASET_FILE).write_text(json.dumps(older), encoding="utf-8")
    with pytest.raises(InputError, match="begun with shards of schema binpose-shard/1"):
        prepared = prepare_object("brick")
        config = replace(debug(), scenes=3, views=1, shard_scenes=1)
        build(plan(config, prepared.model, prepared.convex_parts), copy, workers=1)


def test_a_shard_of_the_first_schema_among_others_is_named_and_rebuilt(
    built: Path, copy: Path, as_schema_1: Callable[[Path], None], tmp_path: Path
) -> None:
    (tmp_path / "one").mkdir()
    shutil.move(copy / shard_name(1), tmp_path / "one")
    as_schema_1(tmp_path / "one")
    shutil.move(tmp_path / "one" / shard_name(1), copy)
    assert f"{shard_name(1)}: its schema is not that of {DATASET_FILE}" in verify(copy).output
    repair(copy, workers=1)
    assert contents(copy) == contents(built)


@pytest.mark.parametrize("name", [*bullet_version(), "platform"])
def test_piles_of_another_engines_version_or_platform_are_not_mixed_in(copy: Path, name: str) -> None:
    document = json.loads((copy / DATASET_FILE).read_text())
    document["software"][name] = "9.9"
    (copy / DATASET_FILE).write_text(json.dumps(document))
    (copy / shard_name(0)).unlink()
    before = contents(copy)
    result = verify(copy, "--repair")
    assert result.exit_code == 2 and f"{name} 9.9" in result.stderr.splitlines()[-1]
    assert "here would make others" in result.stderr.splitlines()[-1]
    assert contents(copy) == before


def test_a_dataset_of_one_engine_is_not_continued_with_the_other(copy: Path) -> None:
    pytest.importorskip("rapier3d")
    before = contents(copy)
    command = "build --object brick --preset debug --scenes 3 --views 1 --shard-scenes 1 --physics rapier -o"
    result = CliRunner().invoke(cli, [*command.split(), str(copy)])
    assert result.exit_code == 2
    assert "config.physics.engine is pybullet there and rapier here" in result.stderr.splitlines()[-1]
    assert contents(copy) == before
