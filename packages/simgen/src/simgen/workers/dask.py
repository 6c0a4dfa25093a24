"""A Dask cluster in place of this machine's processes: the same tasks, on `Client.get_executor()`.

A task whose worker is lost is handed to another by the scheduler. Workers write shards themselves, so the folder must
be on a file system that all of them see, and their software must be ours, for the shards say what made them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from pathlib import Path
from typing import Any

from evalkit.datasets.shard_folder import DATASET_FILE
from evalkit.errors import InputError
from simgen.scenes.software import software_here
from simgen.workers.progress import SceneProgress
from simgen.workers.tasks import Pool

CONNECT_SECONDS = 20


@contextlib.contextmanager
def dask_cluster(address: str, folder: Path, engine: str) -> Iterator[Pool]:
    """Pools of the cluster whose scheduler is at `address`, for :func:`simgen.workers.tasks.run_tasks`.

    Its workers need the folder, and the physics engine.

    Raises:
        InputError: Dask is not installed, nobody answers, or the workers do not suit.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise InputError(
            "--dask: Dask is not installed; run pip install 'binpose-simgen[dask]', here and where its workers run."
        ) from None
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--dask {address}: no Dask scheduler answers there ({type(error).__name__}); start one with "
            "'dask scheduler' and give the address that it prints, as in tcp://host:8786."
        ) from None
    try:
        _require_suitable(client.run(worker_state, str(folder.absolute()), engine), address, folder, engine)
        yield lambda tasks, progress: _executor(client, progress)
    except KilledWorker:
        raise InputError(
            f"--dask {address}: a shard lost its worker again and again, most likely for lack of memory; "
            "run the same command again with more memory a worker."
        ) from None
    except CancelledError:
        raise InputError(
            f"--dask {address}: the scheduler was lost; what was finished is kept, run the same command again to go on."
        ) from None
    finally:
        client.close()


def worker_state(folder: str, engine: str) -> dict[str, Any]:
    """What a worker sees: whether the folder has its dataset.json there, and the versions that decide the bytes."""
    return {"sees": (Path(folder) / DATASET_FILE).is_file(), "software": software_here(engine)}


@contextlib.contextmanager
def _executor(client: Any, progress: SceneProgress) -> Iterator[Executor]:
    """The cluster as an executor; on an exception, Ctrl-C included, what has not begun is taken back."""
    executor = client.get_executor(pure=False)
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=False)
        raise


def _require_suitable(states: dict[str, dict[str, Any]], address: str, folder: Path, engine: str) -> None:
    """Raise InputError unless there are workers, which see the folder and have our software."""
    if not states:
        raise InputError(f"--dask {address}: the cluster has no workers; start some with 'dask worker {address}'.")
    ours = software_here(engine)
    for worker, state in sorted(states.items()):
        if not state["sees"]:
            raise InputError(
                f"--dask {address}: worker {worker} does not see {folder.absolute()}; "
                "give a folder with -o on a file system that all workers share, under the same path."
            )
        for name, version in ours.items():
            theirs = state["software"].get(name, "(none)")
            if theirs != version:
                raise InputError(
                    f"--dask {address}: worker {worker} has {name} {theirs}, {version} is here; "
                    "give it the same, for it decides the shards' bytes."
                )
