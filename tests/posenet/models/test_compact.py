"""A compact model is the same model, a little rounded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from posenet.models.compact import STEPS, compact, expand
from posenet.models.model_file import load_model, write_compact
from posenet.prediction.predictor import Predictor


def test_weights_come_back_within_half_a_step_of_their_row() -> None:
    weights = {"w": torch.randn(64, 32, 3, 3), "b": torch.randn(64), "n": torch.tensor(7)}
    packed = compact(weights)
    full = expand(packed)
    assert packed["w"].dtype == torch.int8 and set(full) == set(weights)
    step = weights["w"].flatten(1).abs().amax(1) / STEPS
    assert ((full["w"] - weights["w"]).flatten(1).abs() <= 0.501 * step[:, None]).all()
    assert torch.allclose(full["b"], weights["b"], rtol=1e-3)
    assert full["n"] == 7 and full["n"].dtype == torch.int64


def test_rows_of_zeros_stay_zeros() -> None:
    assert (expand(compact({"w": torch.zeros(128, 64)}))["w"] == 0).all()


def test_a_compact_model_is_small_and_predicts_the_same_heap(
    run_folder: Path, debug_shards: Path, tmp_path: Path, run_command: Callable[..., object]
) -> None:
    out = tmp_path / "small.pt"
    done = run_command("posenet", "compact", run_folder, "-o", out)
    assert done.returncode == 0, done.stderr  # type: ignore[attr-defined]
    assert out.stat().st_size < 0.4 * (run_folder / "model.pt").stat().st_size
    assert load_model(out).record == load_model(run_folder).record
    view = ShardDataset(debug_shards)[0]
    before, after = (Predictor.load(model).predict(view.depth, view.camera) for model in (run_folder, out))
    few = min(len(before.score), len(after.score), 3)
    assert np.abs(before.score[:few] - after.score[:few]).max(initial=0.0) < 0.1


def test_the_model_itself_is_not_overwritten(run_folder: Path) -> None:
    with pytest.raises(InputError, match="choose another"):
        write_compact(run_folder / "model.pt", run_folder / "model.pt")
