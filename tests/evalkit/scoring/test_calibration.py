"""Calibration: scores that are shares of what is right have no error, and how far others are off is found."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.scoring.calibration import calibration


def test_scores_drawn_as_probabilities_are_calibrated_and_surer_ones_are_off_by_as_much() -> None:
    rng = np.random.default_rng(0)
    score = rng.uniform(0, 1, 200_000)
    right = rng.random(len(score)) < score
    honest, boastful = calibration(score, right), calibration(np.minimum(score + 0.1, 1.0), right)
    assert honest is not None and boastful is not None
    assert honest.error < 0.006
    assert boastful.error == pytest.approx(0.095, abs=0.003)


def test_bins_count_what_lies_in_them() -> None:
    found = calibration(np.array([0.0, 0.05, 0.31, 0.39, 1.0]), np.array([False, True, True, True, False]))
    assert found is not None
    assert found.count.tolist() == [2, 0, 0, 2, 0, 0, 0, 0, 0, 1]
    assert found.right[0] == 0.5 and found.right[3] == 1.0 and np.isnan(found.right[1])
    assert found.error == pytest.approx((2 * 0.475 + 2 * 0.65 + 1.0) / 5)


def test_numbers_that_are_no_probabilities_have_no_calibration_and_nothing_has_none() -> None:
    assert calibration(np.array([0.2, 3.0]), np.array([True, False])) is None
    nothing = calibration(np.zeros(0), np.zeros(0, bool))
    assert nothing is not None and np.isnan(nothing.error) and nothing.count.sum() == 0
