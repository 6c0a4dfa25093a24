"""The two stages by themselves: simulated here, rendered there, to the bytes of a build in one go."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from click.testing import CliRunner, Result

from evalkit.datasets.shard_folder import ShardDataset, shard_name
from evalkit.datasets.shard_format import seal
from evalkit.errors import InputError
from evalkit.geometry import poses
from simgen.building.scenes_file import simulate
from simgen.commands.cli import cli
from simgen.commands.options import DEFAULT_SHARE
from simgen.objects.foreign_things import parse_distractors
from simgen.objects.prepare import prepare_object
from simgen.presets import debug
from simgen.scenes.file import SCHEMA, job_of_scenes, read_scenes, write_scenes
from simgen.scenes.job import Job
from simgen.scenes.journal import SUFFIX, SimulatedScenes, scene_journal
from simgen.scenes.plan import plan

OPTIONS = (
    "--object", "brick", "--preset", "debug", "--scenes", "3", "--views", "2", "--distractors", "builtin",
    "--workers", "1",
)  # fmt: skip


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in arguments])


def refusal(result: Result) -> str:
    """The one sentence of a command that refused."""
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("Error: ") and result.stderr.count("\n") == 1
    return result.stderr


def brick_job(**changes: Any) -> Job:
    prepared = prepare_object("brick")
    config = replace(debug(), scenes=3, views=2, distractors=parse_distractors("builtin", DEFAULT_SHARE), **changes)
    return plan(config, prepared.model, prepared.convex_parts)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenes") / "scenes.h5"
    result = run("simulate", *OPTIONS, "-o", path)
    assert result.exit_code == 0, result.output
    assert "3 scenes simulated" in result.output
    return path


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built") / "shards"
    assert run("build", *OPTIONS, "-o", folder).exit_code == 0
    return folder


def test_rendering_needs_no_pybullet_and_gives_the_bytes_of_a_build(scenes: Path, built: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "blocked"
    for module in ("pybullet", "pybullet_data", "coacd"):
        (blocked / module).mkdir(parents=True)
        (blocked / module / "__init__.py").write_text("raise ImportError('blocked')")
    path = os.pathsep.join([str(blocked), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [Path(sys.executable).with_name("simgen"), "render", scenes, "-o", tmp_path / "out", "--workers", "1"]
    done = subprocess.run(
        list(map(str, command)), env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "out") == contents(built)


def test_rendering_again_goes_on_where_a_build_stopped(scenes: Path, built: Path, tmp_path: Path) -> None:
    for path in built.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / shard_name(1)).unlink()
    assert "1 shards kept" in run("render", scenes, "-o", tmp_path, "--workers", "1").output
    assert contents(tmp_path) == contents(built)


def test_what_concerns_cameras_can_be_given_anew(scenes: Path, built: Path, tmp_path: Path) -> None:
    result = run(
        "render", scenes, "-o", tmp_path / "out", "--workers", "1", "--sensor", "stereo", "--keep-ideal", "--views",
        "1", "--compression", "gzip", "--shard-scenes", "3",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    noisy, ideal = ShardDataset(tmp_path / "out"), ShardDataset(built)
    assert len(noisy.paths) == 1 and len(noisy) == 3
    for view, same in zip(noisy, list(ideal)[::2], strict=True):
        assert np.array_equal(view.instances.cam_from_obj, same.instances.cam_from_obj)
        assert np.array_equal(view.depth_ideal_raw, same.depth_raw) and not np.array_equal(
            view.depth_raw, same.depth_raw
        )
    assert "another dataset" in refusal(run("render", scenes, "-o", tmp_path / "out", "--workers", "1"))


def test_simulating_again_changes_nothing_and_other_scenes_are_refused(scenes: Path) -> None:
    before = scenes.read_bytes()
    assert "0 scenes simulated" in run("simulate", *OPTIONS, "-o", scenes).output
    assert "config.seed is 0 there and 5 here" in refusal(run("simulate", *OPTIONS, "--seed", "5", "-o", scenes))
    assert scenes.read_bytes() == before
    assert sorted(path.name for path in scenes.parent.iterdir()) == [scenes.name]


def test_poses_come_back_to_the_last_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    flips = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])])
    tiny = poses.from_axis_angle([[0.0, 0.0, 1.0]], [1e-9])
    turns = np.concatenate([poses.random_rotations(rng, 500), flips, tiny])
    every = poses.from_rotation_translation(turns, rng.normal(0, 1, (len(turns), 3)))
    given = [every[:1], every[1:20], every[20:]]
    job = brick_job()
    write_scenes(tmp_path / "s.h5", job.header, given, [1, 2, 3])
    header, back = read_scenes(tmp_path / "s.h5")
    assert [scene.tobytes() for scene in back.world_from_obj] == [scene.tobytes() for scene in given]
    assert (back.attempts, header.config) == ([1, 2, 3], job.header.config)


def test_two_thousand_scenes_take_two_megabytes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    turns, places = poses.random_rotations(rng, 30_000), rng.uniform(-0.3, 0.3, (30_000, 3))
    every = poses.from_rotation_translation(turns, places)
    write_scenes(tmp_path / "s.h5", brick_job().header, np.split(every, 2000), [1] * 2000)
    assert (tmp_path / "s.h5").stat().st_size < 2.1e6


# ---- bad files ----


def test_what_is_no_scenes_file_is_refused_in_one_sentence(built: Path, tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("poses, honestly")
    (tmp_path / "empty.h5").write_bytes(b"")
    for path, words in (
        (tmp_path / "nowhere.h5", "no such scenes file"),
        (tmp_path / "text.h5", "not a readable HDF5 file"),
        (tmp_path / "empty.h5", "not a readable HDF5 file"),
        (built / shard_name(0), "its schema is 'binpose-shard/2', not 'binpose-scenes/1'"),
    ):
        sentence = refusal(run("render", path, "-o", tmp_path / "out"))
        assert words in sentence and str(path) in sentence
    assert not (tmp_path / "out").exists()


def test_every_flipped_bit_and_every_cut_is_found(scenes: Path, tmp_path: Path) -> None:
    sound, path, rng = scenes.read_bytes(), tmp_path / "bad.h5", np.random.default_rng(1)
    for place in rng.integers(0, len(sound), 40):
        spoiled = bytearray(sound)
        spoiled[place] ^= 1 << int(rng.integers(8))
        padding = spoiled[:512].rstrip(b"\0") == sound[:512].rstrip(b"\0") and place < 512
        path.write_bytes(bytes(spoiled))
        if not padding:
            with pytest.raises(InputError, match=r"bad\.h5"):
                job_of_scenes(path)
    for length in (0, 100, 600, len(sound) // 2, len(sound) - 1):
        path.write_bytes(sound[:length])
        with pytest.raises(InputError, match=r"bad\.h5"):
            job_of_scenes(path)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda file: file.attrs.__setitem__("schema", "binpose-scenes/9"), "its schema is 'binpose-scenes/9'"),
        (lambda file: file.__delitem__("attempts"), "damaged or incomplete"),
        (lambda file: file["instances"].write_direct(np.array([1, 1, 10**6], np.int32)), "do not fit together"),
        (lambda file: file["translation"].write_direct(np.full(file["translation"].shape, np.nan)), "not rigid"),
        (lambda file: file["correction"].write_direct(np.full(file["correction"].shape, 1 << 60)), "not rigid"),
        (lambda file: _change_config(file, views=None), "config.views: expected int, got null"),
        (lambda file: _change_config(file, scenes=7), "holds 3 of 7 scenes"),
        (lambda file: file.__delitem__("object/faces"), "damaged or incomplete"),
        (lambda file: file.attrs.__setitem__("object", "{}"), "the field"),
    ],
)
def test_sealed_nonsense_is_refused(scenes: Path, tmp_path: Path, spoil: Callable[[Any], object], words: str) -> None:
    path = tmp_path / "odd.h5"
    path.write_bytes(scenes.read_bytes())
    with h5py.File(path, "r+") as file:
        spoil(file)
    seal(path, SCHEMA)
    sentence = refusal(run("render", path, "-o", tmp_path / "out"))
    assert words in sentence and "odd.h5" in sentence


def _change_config(file: Any, **changes: Any) -> None:
    file.attrs["config"] = json.dumps(json.loads(file.attrs["config"]) | changes)


# ---- interruptions ----


def test_a_simulation_killed_outright_goes_on_where_it_was(tmp_path: Path) -> None:
    options = ("--object", "brick", "--preset", "debug", "--scenes", "9", "--shard-scenes", "1", "--workers", "1")
    command = [str(Path(sys.executable).with_name("simgen")), "simulate", *options]
    with subprocess.Popen([*command, "-o", "cut.h5"], cwd=tmp_path, stderr=subprocess.DEVNULL) as process:
        journal, deadline = tmp_path / f"cut.h5{SUFFIX}", time.monotonic() + 120
        while not journal.exists() or journal.read_bytes().count(b"\n") < 3:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    with journal.open("ab") as file:
        file.write(b"half a li")
    kept = journal.read_bytes().count(b"\n") - 1
    result = run("simulate", *options, "-o", tmp_path / "cut.h5")
    assert f"{9 - kept} scenes simulated" in result.output and f"{kept} kept" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["cut.h5"]
    assert run("simulate", *options, "-o", tmp_path / "whole.h5").exit_code == 0
    assert (tmp_path / "cut.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()


def test_the_journal_drops_a_damaged_line_and_all_after_it(tmp_path: Path) -> None:
    path, scene = tmp_path / "s.h5", [np.eye(4)[None]]
    with scene_journal(path, {"seed": 1}) as journal:
        for task in range(4):
            journal.append(SimulatedScenes(task, scene, [1]))
    file = tmp_path / f"s.h5{SUFFIX}"
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:3]) + lines[3].replace(b'"task": 2', b'"task": 7') + lines[4])
    with scene_journal(path, {"seed": 1}) as journal:
        assert sorted(journal.finished) == [0, 1]
        assert np.array_equal(journal.finished[1].world_from_obj[0], scene[0])
        journal.append(SimulatedScenes(9, scene, [2]))
    with scene_journal(path, {"seed": 1}) as journal:
        assert sorted(journal.finished) == [0, 1, 9] and journal.finished[9].redone == 1


def test_two_simulations_do_not_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    with (
        scene_journal(path, {"seed": 1}),
        pytest.raises(InputError, match="another 'simgen simulate' is writing it"),
        scene_journal(path, {"seed": 1}),
    ):
        pass
    with pytest.raises(InputError, match="scenes of another config"), scene_journal(path, {"seed": 2}):
        pass


def test_the_number_of_workers_does_not_show(scenes: Path, tmp_path: Path) -> None:
    simulate(brick_job(), tmp_path / "two.h5", workers=2)
    assert (tmp_path / "two.h5").read_bytes() == scenes.read_bytes()
