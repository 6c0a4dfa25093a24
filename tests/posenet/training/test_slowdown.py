"""A training run that loses its cores says so, once."""

from __future__ import annotations

from posenet.training.slowdown import Slowdown


def said(rates: list[float]) -> list[str]:
    slowdown = Slowdown()
    return [sentence for rate in rates if (sentence := slowdown.warning(rate))]


def test_a_collapse_is_told_once_with_both_rates() -> None:
    (sentence,) = said([1.0, 20.0, 25.0, 24.0, 8.0, 0.8, 0.8, 25.0, 0.8])
    assert "from 25.0 to 8.0 images/s" in sentence
    assert "OMP_NUM_THREADS=1" in sentence


def test_a_slow_first_step_and_the_scores_that_train_later_are_no_collapse() -> None:
    assert said([0.2, 5.0, 20.0, 25.0, 14.0, 12.0]) == []
