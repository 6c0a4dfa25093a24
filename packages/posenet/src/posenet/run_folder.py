"""A run's folder: what a run is, where it stands, and its best model.

::

    run.json        preset, options, seed, data and its hash, software: a run is resumed only by the same command
    checkpoint.pt   last state: weights, optimisers, random state, progress
    model.pt        best model so far by validation AP (the last one without validation)
    metrics.jsonl   one line a validation
    events.*        TensorBoard
"""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from evalkit.atomic import atomic_path, write_json
from evalkit.errors import InputError
from evalkit.shards import USER_BLOCK, ShardDataset
from posenet.model_file import MODEL_FILE, read_torch_file

RUN_FORMAT = "binpose-run/1"


@dataclass(frozen=True)
class RunFolder:
    """Paths of a run, and its state on disk."""

    path: Path

    @property
    def model(self) -> Path:
        return self.path / MODEL_FILE

    @property
    def checkpoint(self) -> Path:
        return self.path / "checkpoint.pt"

    def claim(self, identity: dict[str, Any]) -> bool:
        """Make the folder this run's own; True if a checkpoint of the same run is there to go on from.

        Raises:
            InputError: the folder holds another run.
        """
        file = self.path / "run.json"
        if not file.exists():
            write_json(file, {"format": RUN_FORMAT, **identity}, indent=1)
            return False
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
        except (UnicodeDecodeError, json.JSONDecodeError):
            raise InputError(f"{file}: not a readable run file; remove the folder or choose another with -o.") from None
        different = [key for key in identity if known.get(key) != json.loads(json.dumps(identity[key]))]
        different = [key for key in different if key != "software"]
        if different:
            raise InputError(
                f"{self.path}: holds a run that differs in {', '.join(different)}; give the same options to resume it, "
                "or another folder with -o."
            )
        return self.checkpoint.exists()

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        with atomic_path(self.checkpoint) as temporary:
            torch.save(state, temporary)

    def load_checkpoint(self) -> dict[str, Any]:
        return read_torch_file(self.checkpoint)

    def log_metrics(self, metrics: dict[str, Any]) -> None:
        with open(self.path / "metrics.jsonl", "a", encoding="utf-8") as file:
            file.write(json.dumps(metrics) + "\n")


def software_versions() -> dict[str, str]:
    packages = ("binpose-posenet", "binpose-evalkit", "torch", "lightning-fabric", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def data_hash(dataset: ShardDataset) -> str:
    """A hash of the shards' own checksums, which stand in their first bytes: cheap, and changes with any byte."""
    digest = hashlib.sha256()
    for path in dataset.paths:
        with open(path, "rb") as file:
            digest.update(file.read(USER_BLOCK))
    return digest.hexdigest()
