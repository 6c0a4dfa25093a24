"""Precision-recall curves: figures worked out by hand, and laws."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit import GroundTruth, GroundTruthImage, PredictionImage, Predictions, average_precision
from evalkit.scoring.precision_recall import COCO_RECALLS, Curve


def curve(precision, recall):
    return Curve(-np.arange(len(precision), dtype=float), np.array(precision), np.array(recall))


def test_average_precision_is_the_area_under_the_steps():
    assert curve([1.0, 0.5, 2 / 3], [0.5, 0.5, 1.0]).average_precision == pytest.approx(0.5 + 0.5 * 2 / 3)


def test_average_precision_may_lose_recall_again():
    """A nearer hypothesis that belongs elsewhere takes a match away: the curve steps back, and the area with it."""
    assert curve([1.0, 0.5], [0.5, 0.25]).average_precision == pytest.approx(0.5 - 0.125)


def test_interpolated_average_precision_takes_the_best_precision_from_there_on():
    steps = curve([1.0, 0.5, 0.6], [0.2, 0.2, 0.7])
    expected = np.mean([1.0 if r <= 0.2 + 1e-9 else 0.6 if r <= 0.7 + 1e-9 else 0.0 for r in COCO_RECALLS])
    assert steps.interpolated_average_precision == pytest.approx(expected)


def test_f1_is_zero_where_precision_and_recall_are():
    assert curve([0.0, 0.5], [0.0, 0.5]).f1.tolist() == [0.0, 0.5]


def test_the_toolboxs_recall_is_that_of_the_last_point_precise_enough():
    steps = curve([1.0, 1.0, 0.98, 0.995, 0.9], [0.2, 0.4, 0.3, 0.35, 0.5])
    assert (steps.recall_at_precision(0.99), steps.recall_at_last_precision(0.99)) == (0.4, 0.35)
    assert steps.recall_at_last_precision(0.5) == 0.5  # it never falls so low: at the end
    assert steps.recall_at_last_precision(1.1) == 0.0


def test_recall_at_precision_is_zero_where_the_precision_is_never_reached():
    steps = curve([0.9, 0.8, 0.4], [0.1, 0.3, 0.5])
    assert [steps.recall_at_precision(p) for p in (0.95, 0.8, 0.2)] == [0.0, 0.3, 0.5]


def false_alarm_first(model):
    """One instance in each of two images; in the first a false hypothesis scores above the true one."""
    one = np.eye(4)[None]
    far = one + 5 * np.eye(4)[2][:, None] * np.eye(4)[3]
    truth = GroundTruth(model, [GroundTruthImage(name, None, one, np.ones(1)) for name in "ab"])
    predictions = Predictions(
        model.name,
        [
            PredictionImage("a", np.concatenate([far, one]), np.array([0.9, 0.6])),
            PredictionImage("b", one, np.array([0.7])),
        ],
    )
    return predictions, truth


def test_means_over_images_are_taken_at_every_score_of_any_image(plain_model):
    predictions, truth = false_alarm_first(plain_model)
    found = average_precision(predictions, truth)
    assert found.curve.score.tolist() == [0.9, 0.7, 0.6]
    assert found.curve.precision.tolist() == [0.5, 0.5, 0.75]  # b has precision 1 before its first hypothesis
    assert found.curve.recall.tolist() == [0.0, 0.5, 1.0]
    assert found.ap == pytest.approx(0.25 + 0.375)
    assert found.map == pytest.approx((0.5 + 1.0) / 2)


def test_the_coco_curve_pools_all_images(plain_model):
    predictions, truth = false_alarm_first(plain_model)
    found = average_precision(predictions, truth, protocol="coco")
    assert found.curve.precision.tolist() == pytest.approx([0.0, 0.5, 2 / 3])
    assert found.curve.recall.tolist() == [0.0, 0.5, 1.0]
    assert found.ap == pytest.approx(2 / 3)


def test_one_more_false_alarm_at_the_top_never_helps_the_coco_figure(symmetric_model, make_crowd):
    """In the Siléane protocol it can, where recall steps back: what is then taken off weighs less."""
    predictions, truth = make_crowd(symmetric_model, 11)
    far = np.eye(4)[None] + 5 * np.eye(4)[2][:, None] * np.eye(4)[3]
    first = predictions.images[0]
    worse = PredictionImage(first.id, np.concatenate([first.cam_from_obj, far]), np.r_[first.score, 99.0])
    alarmed = Predictions(predictions.object, [worse, *predictions.images[1:]])
    before, after = (average_precision(p, truth, protocol="coco").ap for p in (predictions, alarmed))
    assert after <= before
