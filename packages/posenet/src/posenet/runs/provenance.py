"""Where a run comes from: versions of the software, the checkout, and the bytes of its data."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.datasets.shard_format import USER_BLOCK


def software_versions() -> dict[str, str]:
    packages = ("binpose-posenet", "binpose-evalkit", "torch", "lightning-fabric", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def git_version() -> str | None:
    """The commit of the checkout that this file belongs to, '-dirty' where it was changed; None outside of any."""
    here = Path(__file__)
    try:
        if _git(here.parent, "ls-files", "--error-unmatch", here.name) is None:
            return None  # installed below somebody's checkout, but no part of it
        return _git(here.parent, "describe", "--always", "--dirty", "--abbrev=12")
    except (OSError, subprocess.TimeoutExpired):
        return None


def shard_hashes(dataset: ShardDataset) -> dict[str, str]:
    """The SHA-256 that each shard carries in its first bytes, by the shard's name: cheap, and changes with any byte."""
    hashes = {}
    for path in dataset.paths:
        with open(path, "rb") as file:
            words = file.read(USER_BLOCK).rstrip(b"\0").split()
        hashes[path.name] = words[-1].decode("ascii", "replace") if words else ""
    return hashes


def data_hash(dataset: ShardDataset) -> str:
    """One hash of all shards' own checksums."""
    digest = hashlib.sha256()
    for path in dataset.paths:
        with open(path, "rb") as file:
            digest.update(file.read(USER_BLOCK))
    return digest.hexdigest()


def _git(folder: Path, *words: str) -> str | None:
    done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10, check=False)
    return done.stdout.strip() if done.returncode == 0 else None
