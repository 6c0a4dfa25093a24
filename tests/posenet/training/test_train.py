"""Training learns, resumes, and says in one sentence what it cannot do."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from evalkit.errors import InputError
from posenet.config import Config, preset, with_options
from posenet.layers.mean import Mean
from posenet.models.model_file import load_model
from posenet.optimizers.schedule import Budget, learning_rate_factor
from posenet.training import learner
from posenet.training.dataset import Frames
from posenet.training.fit_options import FitOptions
from posenet.training.train import fit
from posenet.training.trainer import Trainer
from posenet.training.validation import validate


def options(shards: Path, out: Path, config: Config | None = None, **rest: object) -> FitOptions:
    chosen = {"epochs": 2, "device": "cpu", "validate": False} | rest
    return FitOptions([shards], out, config or preset("debug"), **chosen)  # type: ignore[arg-type]


def test_it_overfits_two_scenes(debug_shards: Path, tmp_path: Path) -> None:
    """All labels, heads and decoders agree, or this cannot be."""
    run = fit(options(debug_shards, tmp_path / "run", epochs=220))
    frames = Frames(debug_shards)
    network = load_model(run.path).network
    result = validate(network, frames, np.arange(len(frames.dataset)), torch.device("cpu"))
    assert result.ap >= 0.9


@pytest.mark.parametrize("changes", [{}, {"depth": "absolute", "roi": "box", "crop_size": 0, "confidence": "product"}])
def test_every_part_gets_a_gradient(debug_shards: Path, tmp_path: Path, changes: dict[str, object]) -> None:
    config = with_options(preset("debug"), "network", **changes)
    config = with_options(config, "train", scoring_start=0.0, scoring_every=1)
    run = fit(options(debug_shards, tmp_path / "run", config))
    network = load_model(run.path).network
    torch.manual_seed(0)
    batch = Frames(debug_shards).batch(np.arange(2))
    found = network.train()(batch, 2)
    torch.stack([part.value for part in found.values()]).sum().backward()
    without = [name for name, p in network.named_parameters() if p.grad is None or not torch.isfinite(p.grad).all()]
    assert without == []


def test_the_paper_preset_takes_a_step_in_miniature(debug_shards: Path, tmp_path: Path) -> None:
    """The paper's choices on a thin trunk: RPN, boxes as regions, hard bins over absolute depth, registration."""
    config = preset("paper")
    thin = dataclasses.replace(config.network, backbone="vgg_debug", fc_width=64, registration_blocks=2)
    config = dataclasses.replace(config, network=thin)
    config = with_options(config, "train", scoring_start=0.0)
    run = fit(options(debug_shards, tmp_path / "run", config, epochs=1))
    record = load_model(run.path).record
    assert record["images"] == 6


def test_images_without_instances_train(debug_shards: Path) -> None:
    frames = Frames(debug_shards)
    batch = frames.batch(np.arange(2))
    empty = batch._replace(
        poses=[torch.zeros(0, 4, 4)] * 2, boxes=[torch.zeros(0, 4)] * 2, visibility=[torch.zeros(0)] * 2
    )
    for name in ("debug", "paper"):
        config = preset(name)
        network_config = dataclasses.replace(config.network, backbone="vgg_debug", fc_width=64)
        from posenet.network.pose_network import PoseNetwork

        network = PoseNetwork(
            dataclasses.replace(config, network=network_config), frames.model, (0.3, 0.6), frames.camera
        )
        loss = torch.stack([part.value for part in network(empty, 1).values()]).sum()
        loss.backward()
        assert torch.isfinite(loss)


@pytest.mark.parametrize(
    "choices", [{"optimizer": "adamw"}, {"optimizer": "muon"}, {"augment_noise": 0.02, "augment_holes": 0.02}], ids=str
)
def test_a_stopped_run_goes_on_as_if_it_had_not_stopped(
    debug_shards: Path, tmp_path: Path, choices: dict[str, Any]
) -> None:
    config = with_options(preset("debug"), "train", **choices)
    whole = fit(options(debug_shards, tmp_path / "whole", config, epochs=6))
    stopped = options(debug_shards, tmp_path / "stopped", config, epochs=6)
    take = Trainer.take_step

    def stop_at_three(self: Trainer, progress: float) -> None:
        if self.step == 3:
            raise KeyboardInterrupt
        take(self, progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "take_step", stop_at_three)
        with pytest.raises(KeyboardInterrupt):
            fit(stopped)
    assert load_model(tmp_path / "stopped").record["images"] == 12
    torch.manual_seed(99)
    resumed = fit(stopped)
    a, b = (load_model(run.path).network.state_dict() for run in (whole, resumed))
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_a_finished_run_trains_no_more(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run"))
    before = run.model.read_bytes()
    fit(options(debug_shards, tmp_path / "run"))
    assert run.model.read_bytes() == before


def test_another_run_in_the_same_folder_is_refused(debug_shards: Path, tmp_path: Path) -> None:
    fit(options(debug_shards, tmp_path / "run"))
    with pytest.raises(InputError, match="differs in seed"):
        fit(options(debug_shards, tmp_path / "run", seed=3))


def test_a_nan_loss_stops_with_a_sentence_and_keeps_the_checkpoint(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = learner.losses.total

    def poisoned(found: dict[str, Mean], config: object) -> torch.Tensor:
        return real(found, config) * math.nan  # type: ignore[arg-type]

    fit(options(debug_shards, tmp_path / "run", epochs=1))
    kept = (tmp_path / "run" / "checkpoint.pt").read_bytes()
    monkeypatch.setattr(learner.losses, "total", poisoned)
    with pytest.raises(InputError, match="NaN at step"):
        fit(options(debug_shards, tmp_path / "other", epochs=1))
    assert (tmp_path / "run" / "checkpoint.pt").read_bytes() == kept


def test_too_few_scenes_to_validate_on_are_refused(debug_shards: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--no-validation"):
        fit(options(debug_shards, tmp_path / "run", validate=True))


def test_held_out_scenes_do_not_train() -> None:
    class Scenes(Frames):
        def __init__(self) -> None:
            self.dataset = type("Dataset", (), {"scene_index": np.repeat(np.arange(40), 3)})()  # type: ignore[assignment]

    split = Scenes().split(0.1, seed=0, most_images=100)
    scene = np.repeat(np.arange(40), 3)
    assert len(split.validation) == 12
    assert not set(scene[split.train]) & set(scene[split.validation])


def test_the_model_file_says_where_it_comes_from(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run"))
    trained = load_model(run.path)
    assert trained.record["preset"] == "debug" and trained.record["images"] == 8
    assert trained.network.model.name == "bunny"
    assert trained.network.camera.width == 160
    assert json.loads((run.path / "run.json").read_text())["epochs"] == 2


@pytest.mark.parametrize("content", [b"", b"not a model", b"PK\x03\x04 broken zip"])
def test_a_damaged_model_is_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.pt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"model\.pt"):
        load_model(path)


def test_time_spent_before_counts() -> None:
    budget = Budget(minutes=10.0)
    budget.spent_before = 300.0
    assert budget.progress(0) == pytest.approx(0.5, abs=0.01)
    assert Budget(steps=10).progress(4) == pytest.approx(0.4)


def test_one_cycle_rises_then_falls_to_nearly_nothing() -> None:
    factors = [learning_rate_factor(p, "one-cycle", 0.1) for p in np.linspace(0, 1, 101)]
    assert max(factors) == pytest.approx(factors[10], abs=0.01)
    assert factors[-1] < 1e-3 and (np.diff(factors[10:]) <= 0).all()


def test_a_trapezoid_rises_stays_and_falls_to_nearly_nothing() -> None:
    factors = np.array([learning_rate_factor(p, "trapezoid", 0.1, 0.4) for p in np.linspace(0, 1, 101)])
    assert (np.diff(factors[:10]) > 0).all() and (np.diff(factors[61:]) < 0).all()
    assert np.allclose(factors[11:60], 1.0, atol=1e-3) and factors[-1] < 1e-3


def test_cosine_begins_at_its_peak_and_constant_stays_there() -> None:
    cosine = [learning_rate_factor(p, "cosine", 0.1) for p in np.linspace(0, 1, 101)]
    assert cosine[0] == max(cosine) == pytest.approx(1.0, abs=1e-3)
    assert cosine[-1] < 1e-3 and (np.diff(cosine) <= 0).all()
    constant = [learning_rate_factor(p, "constant", 0.1) for p in np.linspace(0.1, 1, 10)]
    assert constant == [1.0] * 10
