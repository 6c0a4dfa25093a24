"""A run's folder: what a run is, where it stands, and its models.

::

    run.json        preset, options, seed, data and its hashes: a run is resumed only by the same command;
                    and how it was made: the command, the folder it was typed in, commit and versions
    checkpoint.pt   last state: weights, optimizers, random state, progress
    model.pt        best model so far by validation AP (the last one without validation)
    last.pt         the model at the last validation, or at the end
    metrics.jsonl   one line a validation
    losses.jsonl    one line every few steps: mean losses
    curves.png      both, drawn
    events.*        TensorBoard: the same, and predictions on a validation image
"""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evalkit.atomic import write_json, write_text
from evalkit.datasets.shard_folder import DATASET_FILE
from evalkit.errors import InputError
from posenet.config import Config
from posenet.models.model_file import MODEL_FILE, read_torch_file, write_torch_file
from posenet.runs.progress_chart import draw_progress

RUN_FORMAT = "binpose-run/1"
LENGTH = ("minutes", "epochs")  # what may change from one command to the next: a longer budget goes on
Rows = list[dict[str, float]]


@dataclass(frozen=True)
class RunFolder:
    """Paths of a run, and its state on disk."""

    path: Path

    @property
    def model(self) -> Path:
        return self.path / MODEL_FILE

    @property
    def last(self) -> Path:
        return self.path / "last.pt"

    @property
    def checkpoint(self) -> Path:
        return self.path / "checkpoint.pt"

    def length(self) -> dict[str, Any]:
        """The budget (LENGTH) that the run in this folder was last given; nothing where there is no run."""
        file = self.path / "run.json"
        return {key: self._read(file).get(key) for key in LENGTH} if file.exists() else {}

    def claim(self, identity: dict[str, Any], length: dict[str, Any], made_by: dict[str, Any]) -> bool:
        """Make the folder this run's own; True if a checkpoint of the same run is there to go on from.

        Args:
            identity: what must be the same for a run to be resumed. length: its budget (LENGTH), which may change.
            made_by: what is noted beside it.

        Raises:
            InputError: the folder holds another run, or what is none and would be overwritten or mixed with one.
            OSError: it cannot be written.
        """
        file = self.path / "run.json"
        if not file.exists():
            self._require_empty_of_others()
            write_json(file, {"format": RUN_FORMAT, **identity, **length, "made_by": made_by}, indent=1)
            return False
        known, wanted = _comparable(self._read(file)), _comparable(json.loads(json.dumps(identity)))
        different = [key for key in wanted if known.get(key) != wanted[key]]
        if different:
            raise InputError(
                f"{self.path}: holds a run that differs in {', '.join(different)}; give the same options to resume it, "
                "or another folder with -o."
            )
        self._require_writable()
        return self.checkpoint.exists()

    def _require_empty_of_others(self) -> None:
        """Refuse a folder with a model of another making, or with shards; run.json is there before a run's own."""
        others = [self.model, self.last, self.checkpoint, self.path / DATASET_FILE]
        there = next((file for file in others if file.exists()), None)
        if there is not None:
            raise InputError(f"{there}: is there, but no run's (run.json is missing); choose another folder with -o.")

    def note_length(self, length: dict[str, Any]) -> None:
        """Write down another budget than before; for whoever has the folder locked."""
        if self.length() != length:
            write_json(self.path / "run.json", {**self._read(self.path / "run.json"), **length}, indent=1)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """The folder for this process alone; what a killed one left half-written is removed.

        Raises:
            InputError: another process trains in it.
        """
        folder = os.open(self.path, os.O_RDONLY)  # not a file in it, which might be replaced
        try:
            try:
                fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    f"{self.path}: another process is training in this folder; wait for it, or choose another with -o."
                ) from None
            self._remove_leftovers()
            yield
        finally:
            os.close(folder)

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        write_torch_file(self.checkpoint, state)

    def load_checkpoint(self) -> dict[str, Any]:
        return read_torch_file(self.checkpoint)

    def write_progress(self, history: Rows, validations: Rows) -> None:
        """Losses and validations so far, as lines and as curves."""
        write_text(self.path / "losses.jsonl", _lines(history))
        write_text(self.path / "metrics.jsonl", _lines(validations))
        draw_progress(self.path / "curves.png", history, validations, self.path.name)

    def _read(self, file: Path) -> dict[str, Any]:
        try:
            return dict(json.loads(file.read_text(encoding="utf-8")))
        except (UnicodeDecodeError, TypeError, ValueError):
            raise InputError(f"{file}: not a readable run file; remove the folder or choose another with -o.") from None

    def _remove_leftovers(self) -> None:
        """Half-written files of a run that was killed while it wrote."""
        for leftover in self.path.glob(".*.tmp"):
            leftover.unlink(missing_ok=True)

    def _require_writable(self) -> None:
        try:
            tempfile.TemporaryFile(dir=self.path).close()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from error


def _comparable(document: dict[str, Any]) -> dict[str, Any]:
    """Without what an update of posenet may add: options at their defaults, and hashes beside the one of all data."""
    config = Config.from_json(document.get("config"), "run.json: config").to_json()
    data = document.get("data", {})
    return {**document, "config": json.loads(json.dumps(config)), "data": data.get("sha256")}


def _lines(rows: Rows) -> str:
    return "".join(json.dumps(row) + "\n" for row in rows)
