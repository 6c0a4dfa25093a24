"""Builds that are stopped or killed at any moment: nothing is lost, and the bytes are those of one that was not."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from angle_job import SMALL, digests, job_of, times

from evalkit.datasets.shard_folder import shard_name
from evalkit.datasets.shard_format import checksum_problem
from evalkit.errors import InputError
from simgen.building.build import build

SHARDS = 12
CONFIG = replace(SMALL, scenes=2 * SHARDS)
COMMAND = """
import sys
from dataclasses import replace
from pathlib import Path
sys.path.insert(0, {here!r})
from angle_job import SMALL, job_of
from simgen.building.build import build
if __name__ == "__main__":
    build(job_of(replace(SMALL, scenes={scenes})), Path({folder!r}), workers=2)
"""


@contextlib.contextmanager
def building(folder: Path, script: Path, shards: int = 2) -> Iterator[subprocess.Popen[bytes]]:
    """A build of all shards in a process of its own, yielded when `shards` of them are done."""
    script.write_text(COMMAND.format(here=str(Path(__file__).parent), folder=str(folder), scenes=CONFIG.scenes))
    # A runner in a shell's background ignores Ctrl-C, and so would all that it starts.
    process = subprocess.Popen(
        [sys.executable, str(script)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        deadline = time.monotonic() + 120
        while not folder.exists() or len(list(folder.glob("shard-*.h5"))) < shards:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.02)
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def children_of(pid: int) -> list[int]:
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(word) for word in listed.stdout.split()]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("uninterrupted") / "shards"
    build(job_of(CONFIG), folder, workers=1)
    return digests(folder)


def test_a_build_killed_outright_is_completed_by_running_it_again(
    tmp_path: Path, uninterrupted: dict[str, str]
) -> None:
    folder, job = tmp_path / "cut", job_of(CONFIG)
    with building(folder, tmp_path / "script.py") as process:
        workers = children_of(process.pid)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        deadline = time.monotonic() + 20
        while any(Path(f"/proc/{worker}").exists() for worker in workers):
            assert time.monotonic() < deadline, "workers must not outlive their parent"
            time.sleep(0.05)
    done = times(folder)
    assert 2 <= len(done) < SHARDS
    report = build(job, folder, workers=1)
    assert report.kept == len(done) and len(report.written) == SHARDS - len(done)
    assert {name: stamp for name, stamp in times(folder).items() if name in done} == done
    assert sorted(path.name for path in folder.iterdir()) == ["dataset.json", *(shard_name(i) for i in range(SHARDS))]
    assert digests(folder) == uninterrupted


def test_the_shards_of_a_killed_worker_are_redone(tmp_path: Path, uninterrupted: dict[str, str]) -> None:
    folder = tmp_path / "maimed"
    with building(folder, tmp_path / "script.py") as process:
        os.kill(max(children_of(process.pid)), signal.SIGKILL)
        assert process.wait(timeout=120) == 0
    assert digests(folder) == uninterrupted
    assert not list(folder.glob(".*.tmp"))


def test_a_running_build_shares_its_folder_with_none_and_ctrl_c_stops_it_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "stopped"
    with building(folder, tmp_path / "script.py") as process:
        with pytest.raises(InputError, match="another 'simgen build' is at work"):
            build(job_of(CONFIG), folder, workers=1)
        start = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(timeout=20) != 0
        assert time.monotonic() - start < 5
    assert not list(folder.glob(".*.tmp"))
    assert all(checksum_problem(path) is None for path in folder.glob("shard-*.h5"))


def kill_at_a_random_moment(folder: Path, script: Path, victim: str, seed: int) -> None:
    """Start the build of `COMMAND` and kill -9 it, or one of its workers, somewhere between its start and its end."""
    rng = np.random.default_rng(seed)
    shards = int(rng.integers(0, SHARDS - 2))
    with building(folder, script, shards) as process:
        time.sleep(float(rng.uniform(0.0, 0.5)))
        workers = children_of(process.pid)
        with contextlib.suppress(ProcessLookupError):  # a worker may just have ended by itself
            os.kill(process.pid if victim == "parent" else int(rng.choice(workers or [process.pid])), signal.SIGKILL)
        process.wait(timeout=300)


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["parent", "worker"])
@pytest.mark.parametrize("seed", range(10))
def test_killed_at_any_moment_the_finished_dataset_has_the_bytes_of_an_uninterrupted_one(
    tmp_path: Path, uninterrupted: dict[str, str], victim: str, seed: int
) -> None:
    folder = tmp_path / "cut"
    kill_at_a_random_moment(folder, tmp_path / "script.py", victim, seed)
    build(job_of(CONFIG), folder, workers=1)  # at once, while orphans may still be on their way out
    assert digests(folder) == uninterrupted
