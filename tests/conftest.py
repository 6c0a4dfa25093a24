"""Data that several packages' tests share: made once a session, by the commands that a user types."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

LONGEST = (  # files that take longest, first: begun last, one of them would keep the other processes waiting
    "test_train", "test_onnx_export", "test_interruption", "test_processes", "test_pipeline", "test_interrupted_builds",
    "test_symmetry_detection", "test_report", "test_wheels",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files come first, so that several processes end at about the same time."""
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))


def _run_command(command: str, *arguments: object, timeout: float = 600) -> subprocess.CompletedProcess[str]:
    """Run one of our commands as installed; its output is text."""
    executable = Path(sys.executable).with_name(command)
    words = [str(executable), *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=timeout, check=False)


@pytest.fixture(scope="session")
def run_command() -> Callable[..., subprocess.CompletedProcess[str]]:
    """`run_command("evalkit", "ap", ...)`: one of our commands, as installed."""
    return _run_command


def _made_once(tmp_path_factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder that whichever process of this test run needs it first makes, and the others take as it is."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    folder, done = base / name, base / f"{name}.done"
    with open(base / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            make(folder)
            done.touch()
    return folder


@pytest.fixture(scope="session")
def debug_shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of bunnies side by side, three views each, 160 x 120. Not to be changed."""

    def make(out: Path) -> None:
        small = ("--preset", "debug", "--scenes", 2, "--bin", "0.3x0.3x0.1", "--workers", 1)
        done = _run_command("simgen", "build", "--object", "bunny", *small, "-o", out)
        assert done.returncode == 0, done.stderr

    return _made_once(tmp_path_factory, "debug-shards", make)


@pytest.fixture(scope="session")
def run_folder(debug_shards: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network trained for some steps: enough for it to detect something. Not to be changed."""
    from posenet.config import preset
    from posenet.training.fit_options import FitOptions
    from posenet.training.train import fit

    def make(out: Path) -> None:
        fit(FitOptions([debug_shards], out, preset("debug"), epochs=40, device="cpu", validate=False))

    return _made_once(tmp_path_factory, "run", make)


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of reference data; tests that need it are skipped where it is absent."""
    beside = Path(__file__).parents[2] / "shared" / "reference"
    folder = Path(os.environ.get("BINPOSE_REFERENCE", beside))
    if not folder.is_dir():
        pytest.skip(f"no reference data at {folder}; set BINPOSE_REFERENCE")
    return folder


@pytest.fixture(scope="session")
def as_schema_1() -> Callable[[Path], None]:
    """`as_schema_1(folder)`: its shards and dataset.json turned into those of the first schema, in place."""
    return _as_schema_1


def _as_schema_1(folder: Path) -> None:
    import h5py

    from evalkit.datasets.shard_format import COUNTED_FIELDS, OLD_NAMES, OLD_SCHEMA, SCHEMA, seal

    for path in folder.glob("shard-*.h5"):
        with h5py.File(path, "r+") as file:
            file.attrs["schema"] = OLD_SCHEMA
            for name in COUNTED_FIELDS:
                del file[name]
            for name, old in OLD_NAMES.items():
                file.move(name, old)
        seal(path, OLD_SCHEMA)
    description = folder / "dataset.json"
    if description.is_file():
        description.write_text(description.read_text(encoding="utf-8").replace(SCHEMA, OLD_SCHEMA), encoding="utf-8")


@pytest.fixture
def chromium(tmp_path: Path) -> Callable[..., str]:
    """`chromium("--dump-dom", address)`: what a headless browser prints, without a GPU."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no chromium here")
    flags = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
             "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
             "--virtual-time-budget=10000", f"--user-data-dir={tmp_path / 'profile'}"]  # fmt: skip

    def run(*arguments: object) -> str:
        words = [browser, *flags, *map(str, arguments)]
        return subprocess.run(words, capture_output=True, text=True, timeout=400, check=False).stdout

    return run
