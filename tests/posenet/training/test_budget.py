"""A run ends in time, goes on when it is given more, and says early when it comes to nothing."""

from __future__ import annotations

import dataclasses
import json
import logging
from pathlib import Path

import pytest

from evalkit.errors import InputError
from posenet.config import Config, preset, with_options
from posenet.models.model_file import load_model
from posenet.optimizers.schedule import HASTE, Budget, learning_rate_factor
from posenet.training import trainer
from posenet.training.fit_options import FitOptions
from posenet.training.forecast import FIRST, LAST, Forecast, forecast
from posenet.training.plateau import learns_nothing, no_longer_rises
from posenet.training.train import fit
from posenet.training.validation import Validation


def options(shards: Path, out: Path, config: Config | None = None, **rest: object) -> FitOptions:
    chosen = {"epochs": 2, "device": "cpu", "validate": False} | rest
    return FitOptions([shards], out, config or preset("debug"), **chosen)  # type: ignore[arg-type]


def validations(*ap: float, first: float = 0.5) -> list[dict[str, float]]:
    step = (1.0 - first) / max(len(ap), 1)
    return [
        {"progress": first + i * step, "ap": value, "images": 9000.0, "box_recall": 0.9} for i, value in enumerate(ap)
    ]


def test_of_steps_and_minutes_what_is_over_first_ends_the_run() -> None:
    assert Budget(steps=10, minutes=1e6).progress(4) == pytest.approx(0.4)
    slow = Budget(steps=1000, minutes=10.0, spent_before=300.0)
    assert slow.progress(4) == pytest.approx(0.5, abs=0.01)


def test_without_a_budget_the_small_preset_counts_images_within_the_hour() -> None:
    config = preset("small").train
    assert config.images > 0 and 0 < config.minutes <= 50


def test_a_run_in_haste_goes_through_all_of_its_schedule() -> None:
    budget = Budget(steps=1000)
    budget.hurry(600)
    budget.hurry(650)  # once is enough
    progress = [budget.progress(step) for step in range(600, 701)]
    assert progress[0] == pytest.approx(0.6) and progress[-1] == pytest.approx(1.0)
    assert progress[50] == pytest.approx(0.6 + HASTE * 0.05)
    factors = [learning_rate_factor(value, "one-cycle", 0.1) for value in progress]
    assert factors == sorted(factors, reverse=True) and factors[-1] < 1e-3


def test_a_finished_run_given_more_goes_on_from_where_it_would_stand(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=2))
    before = load_model(run.path).record["step"]
    more = fit(options(debug_shards, tmp_path / "run", epochs=5))
    record, whole = load_model(more.path).record, fit(options(debug_shards, tmp_path / "whole", epochs=5))
    assert before < record["step"] == load_model(whole.path).record["step"]
    assert json.loads((run.path / "run.json").read_text())["epochs"] == 5


def test_ap_that_falls_when_a_run_is_given_more_does_not_make_it_hurry(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = iter([0.9, 0.91, 0.92, 0.93, 0.5, 0.6, 0.7, 0.94, 0.95, 0.96])
    monkeypatch.setattr(trainer, "validate", lambda *_: Validation(next(measured), 1.0))
    monkeypatch.setattr("posenet.training.dataset.LEAST_SCENES", 2)
    config = with_options(preset("debug"), "train", validations=4, validation_share=0.3)
    asked = options(debug_shards, tmp_path / "run", config, epochs=8, validate=True)
    steps = load_model(fit(asked).path).record["step"]
    more = fit(dataclasses.replace(asked, epochs=12))
    assert json.loads((more.path / "metrics.jsonl").read_text().splitlines()[-1])["step"] == steps * 12 // 8


def test_the_budget_of_a_run_holds_where_none_is_given(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=2))
    before = run.model.read_bytes()
    fit(options(debug_shards, tmp_path / "run", epochs=None))
    assert run.model.read_bytes() == before


def test_less_than_a_run_has_had_is_refused(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=3))
    before = run.model.read_bytes()
    with pytest.raises(InputError, match=r"has trained for .* give more than that in all"):
        fit(options(debug_shards, tmp_path / "run", epochs=2))
    assert run.model.read_bytes() == before


def test_ap_that_rises_goes_on_and_ap_that_does_not_hurries() -> None:
    assert not no_longer_rises(validations(0.5, 0.7, 0.8, 0.85))
    assert not no_longer_rises(validations(0.9, 0.91))
    assert not no_longer_rises(validations(0.9, 0.901, 0.92))
    assert no_longer_rises(validations(0.9, 0.901, 0.902))
    assert no_longer_rises(validations(0.9, 0.999))
    assert not no_longer_rises(validations(0.01, 0.0, 0.0, first=0.1)[:3])  # at the peak of the learning rate


def test_a_run_comes_to_nothing_without_boxes_or_late_without_ap() -> None:
    good = {"images": 9000.0, "progress": 0.7, "ap": 0.3, "box_recall": 0.9}
    assert learns_nothing(good) is None
    assert learns_nothing(good | {"ap": 0.0, "progress": 0.3}) is None
    assert learns_nothing(good | {"box_recall": 0.05, "images": 800.0}) is None
    assert "3% of the held-out instances" in str(learns_nothing(good | {"box_recall": 0.03, "ap": 0.0}))
    assert "AP is 0.001" in str(learns_nothing(good | {"ap": 0.001}))


def test_a_run_that_comes_to_nothing_stops_once_and_goes_on_when_asked_again(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trainer, "validate", lambda *_: Validation(0.0, 0.0))
    monkeypatch.setattr("posenet.training.plateau.BOXES_BY", 8)
    config = with_options(preset("debug"), "train", validations=2, validation_share=0.3)
    monkeypatch.setattr("posenet.training.dataset.LEAST_SCENES", 2)
    asked = options(debug_shards, tmp_path / "run", config, epochs=6, validate=True)
    with pytest.raises(InputError, match="same command again goes on regardless"):
        fit(asked)
    assert len(json.loads((tmp_path / "run" / "metrics.jsonl").read_text().splitlines()[0])) > 3
    fit(asked)
    assert (tmp_path / "run" / "model.pt").exists()


def test_the_forecast_comes_once_and_says_images_minutes_and_what_was_reached(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    said = [Forecast().after_step(Budget(steps=100), 1, 8)]
    told = Forecast()
    said += [told.after_step(Budget(steps=100), step, 8) for step in range(1, LAST + 20)]
    assert FIRST < LAST and len([sentence for sentence in said if sentence]) == 1
    sentence = forecast(Budget(steps=6000, minutes=45.0), 30, 8, 0.4)
    assert "20.0 images/s" in sentence and "40 minutes" in sentence and "48,000 images" in sentence
    assert "AP 0.936 alone" in sentence
    assert "minutes to go, 27,0" in forecast(Budget(steps=6000, minutes=45.0), 0, 8, 0.8)
