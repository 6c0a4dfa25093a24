"""PyBullet and its fork: which one made a dataset's poses is on record, and the poses are the same."""

from __future__ import annotations

import base64
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from simgen.physics.distribution import BULLET_DISTRIBUTIONS, bullet_version
from simgen.scenes.file import read_scenes

SCENES = 10


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder from which modules and distributions are found before all others."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    bullet_version.cache_clear()
    yield tmp_path
    bullet_version.cache_clear()


def install(site: Path, name: str, version: str, code: str) -> None:
    """As pip does: the module, overwriting what is there, and a record of its hash."""
    (site / "pybullet.py").write_text(code)
    metadata = site / f"{name.replace('-', '_')}-{version}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    digest = base64.urlsafe_b64encode(hashlib.sha256(code.encode()).digest()).rstrip(b"=").decode()
    (metadata / "RECORD").write_text(f"pybullet.py,sha256={digest},{len(code)}\n")


@pytest.mark.parametrize("name", BULLET_DISTRIBUTIONS)
def test_the_distribution_that_the_module_comes_from_is_recorded(site: Path, name: str) -> None:
    install(site, name, "9.9", "whose = 'only'")
    assert bullet_version() == {name: "9.9"}


@pytest.mark.parametrize("order", [BULLET_DISTRIBUTIONS, BULLET_DISTRIBUTIONS[::-1]])
def test_of_two_in_one_place_the_later_is_recorded(site: Path, order: tuple[str, str]) -> None:
    for name in order:
        install(site, name, "9.9", f"whose = '{name}'")
    assert bullet_version() == {order[1]: "9.9"}


def test_a_module_that_shadows_them_is_taken_for_neither(site: Path) -> None:
    (site / "pybullet.py").write_text("")
    assert bullet_version() == {}


@pytest.mark.slow
def test_both_make_the_same_poses_to_the_last_bit(tmp_path: Path) -> None:
    """Ten piles of bunnies; two processes, for one process can import only one of them."""
    ((ours, _),) = bullet_version().items()
    (other,) = set(BULLET_DISTRIBUTIONS) - {ours}
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--only-binary", ":all:"]
    done = subprocess.run([*pip, "--target", str(tmp_path / "other"), other], capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"{other} has no wheel for this Python: {done.stderr.splitlines()[-1:]}")
    path = os.pathsep.join([str(tmp_path / "other"), *filter(None, [os.environ.get("PYTHONPATH")])])
    made = {}
    for name, variables in ((ours, {}), (other, {"PYTHONPATH": path})):
        out = tmp_path / f"{name}.h5"
        simulate = [str(Path(sys.executable).with_name("simgen")), "simulate", "--object", "bunny", "--preset", "demo"]
        simulate += ["--scenes", str(SCENES), "-o", str(out)]
        done = subprocess.run(simulate, env=os.environ | variables, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        _, made[name] = read_scenes(out)
        assert made[name].software.keys() & set(BULLET_DISTRIBUTIONS) == {name}
    poses, same = (np.concatenate(made[name].world_from_obj) for name in (ours, other))
    assert len(poses) >= 10 * SCENES
    assert poses.tobytes() == same.tobytes()
