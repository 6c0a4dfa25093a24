"""A Dask cluster of several processes builds what one machine builds, though one of them is killed meanwhile."""

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

import pytest
from click.testing import CliRunner

from evalkit.errors import InputError
from simgen.building.build import build
from simgen.commands.cli import cli
from simgen.objects.prepare import prepare_object
from simgen.presets import debug
from simgen.scenes.job import Job
from simgen.scenes.plan import plan
from simgen.workers.dask import dask_cluster, worker_state

distributed = pytest.importorskip("distributed")
SHARDS = 12


def brick_job() -> Job:
    prepared = prepare_object("brick")
    config = replace(debug(), scenes=SHARDS, views=1, shard_scenes=1)
    return plan(config, prepared.model, prepared.convex_parts)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[int]]]:
    """The address of a scheduler, and the process ids of its three workers."""
    with (
        distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None,
            local_directory=str(tmp_path_factory.mktemp("dask")),
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield cluster.scheduler_address, list(client.run(os.getpid).values())


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_cluster_that_loses_a_worker_writes_the_bytes_of_a_local_build(
    cluster: tuple[str, list[int]], tmp_path: Path
) -> None:
    address, workers = cluster
    command = [str(Path(sys.executable).with_name("simgen")), "build", "--object", "brick", "--preset", "debug"]
    command += ["--scenes", str(SHARDS), "--views", "1", "--shard-scenes", "1", "--dask", address, "-o", "far"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 900
        while not list((tmp_path / "far").glob("shard-*.h5")):
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.01)
        with contextlib.suppress(ProcessLookupError):
            os.kill(workers[0], signal.SIGKILL)
        _, errors = process.communicate(timeout=900)
    assert process.returncode == 0, errors
    build(brick_job(), tmp_path / "here", workers=2)
    assert len(contents(tmp_path / "here")) == SHARDS + 1
    assert contents(tmp_path / "far") == contents(tmp_path / "here")


def test_workers_that_do_not_see_the_folder_are_refused_before_anything_is_built(
    cluster: tuple[str, list[int]], tmp_path: Path
) -> None:
    shared = "on a file system that all workers share"
    with pytest.raises(InputError, match=shared), dask_cluster(cluster[0], tmp_path / "nowhere", "pybullet"):
        pass


def test_workers_with_other_software_are_refused(
    cluster: tuple[str, list[int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "dataset.json").write_text("{}")
    ours = worker_state(str(tmp_path), "pybullet")["software"] | {"numpy": "0.1"}
    monkeypatch.setattr("simgen.workers.dask.software_here", lambda _: ours)
    sentence = r"worker .* has numpy .*, 0\.1 is here; give it the same"
    with pytest.raises(InputError, match=sentence), dask_cluster(cluster[0], tmp_path, "pybullet"):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "ftp://x"])
def test_where_no_scheduler_answers_one_sentence_says_so(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simgen.workers.dask.CONNECT_SECONDS", 1)
    arguments = ["build", "--object", "brick", "--preset", "debug", "--dask", address, "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 2, result.output
    assert f"--dask {address}: no Dask scheduler answers there" in result.stderr.splitlines()[-1]


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match=r"pip install 'binpose-simgen\[dask\]'"),
        dask_cluster("x", tmp_path, "pybullet"),
    ):
        pass
