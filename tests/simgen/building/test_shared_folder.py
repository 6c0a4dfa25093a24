"""Several builds in one folder: each its own shards, none the other's, and together what one build writes."""

from __future__ import annotations

import errno
import fcntl
import functools
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from evalkit.datasets.shard_folder import DATASET_FILE, list_shards, shard_name
from evalkit.errors import InputError
from simgen.building.build import build
from simgen.building.shard_locks import shards_locked
from simgen.commands.cli import cli
from simgen.commands.parsing import parse_shards
from simgen.objects.prepare import prepare_object
from simgen.presets import debug
from simgen.scenes.job import Job
from simgen.scenes.plan import plan

OPTIONS = ("--object", "brick", "--preset", "debug", "--views", "1", "--scenes", "5", "--workers", "1")


brick = functools.cache(lambda: prepare_object("brick"))


def brick_job(**changes: Any) -> Job:
    prepared = brick()
    return plan(replace(debug(), scenes=5, views=1, **changes), prepared.model, prepared.convex_parts)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["build", *map(str, (*OPTIONS, *arguments))])


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built") / "whole"
    build(brick_job(), folder, workers=1)
    return folder


def test_shards_built_apart_are_those_of_one_build(built: Path, tmp_path: Path) -> None:
    result = run("-o", tmp_path, "--shards", "1-7")
    assert result.exit_code == 0, result.output
    assert "shards 1 to 2 of 3, 3 scenes (3 frames) written" in result.output
    assert sorted(contents(tmp_path)) == [DATASET_FILE, shard_name(1), shard_name(2)]
    with pytest.raises(InputError, match="1 of 3 shards are missing"):
        list_shards(tmp_path)
    assert "shards 0 to 0 of 3, 2 scenes (2 frames) written" in run("-o", tmp_path, "--shards", "0").output
    assert contents(tmp_path) == contents(built)
    assert "3 shards kept" in run("-o", tmp_path).output


def test_only_the_leftovers_of_ones_own_shards_are_removed(tmp_path: Path) -> None:
    for shard in (0, 1, 2):
        (tmp_path / f".{shard_name(shard)}.abc.tmp").write_bytes(b"being written")
    assert run("-o", tmp_path, "--shards", "1-1").exit_code == 0
    assert sorted(contents(tmp_path)) == sorted(
        [DATASET_FILE, shard_name(1), *(f".{shard_name(shard)}.abc.tmp" for shard in (0, 2))]
    )


def test_builds_of_the_same_shard_exclude_each_other(built: Path) -> None:
    with shards_locked(built, range(1, 2)) as alone:
        assert alone
        for shards in (range(1, 2), range(0, 3), range(1, 5)):
            with pytest.raises(InputError, match="give other --shards"), shards_locked(built, shards):
                pass
        result = run("-o", built)
        assert result.exit_code == 2 and "another 'simgen build' is at work" in result.stderr
        assert run("-o", built, "--shards", "2").exit_code == 0
        (built / DATASET_FILE).read_bytes()  # closing another handle of the file must not drop the lock
        with pytest.raises(InputError, match="at work"), shards_locked(built, range(1, 2)):
            pass
    with shards_locked(built, range(0, 3)) as alone:
        assert alone


def test_a_file_system_without_locks_is_built_on_and_nothing_is_removed(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(fcntl, "fcntl", refuse)
    leftover = tmp_path / f".{shard_name(0)}.abc.tmp"
    leftover.write_bytes(b"perhaps another's")
    build(brick_job(), tmp_path, workers=1, shards=range(1))
    assert leftover.exists()
    assert (tmp_path / shard_name(0)).read_bytes() == (built / shard_name(0)).read_bytes()


def test_of_builds_that_start_at_once_one_names_the_dataset(tmp_path: Path) -> None:
    """Eight with two different configs: all of one config go on, all of the other are refused."""
    jobs, barrier, refused = [brick_job(seed=number % 2) for number in range(8)], threading.Barrier(8), list[int]()

    def start(number: int) -> None:
        barrier.wait()
        try:
            build(jobs[number], tmp_path, 1, range(number, number))
        except InputError:
            refused.append(number % 2)

    threads = [threading.Thread(target=start, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert refused in ([0] * 4, [1] * 4)
    assert sorted(contents(tmp_path)) == [DATASET_FILE]


def test_shards_are_numbers_from_zero() -> None:
    assert [list(parse_shards(text, 4)) for text in ("0-1", "3", " 2 - 9 ")] == [[0, 1], [3], [2, 3]]
    for text in ("4", "3-2", "-1", "a", "", "1,2"):
        with pytest.raises(InputError, match=f"--shards {text}: give a number or a range"):
            parse_shards(text, 4)
