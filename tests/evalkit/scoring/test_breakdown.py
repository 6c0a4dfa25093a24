"""An evaluation taken apart: the parts agree with the whole, and errors are those that were put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evalkit import GroundTruth, GroundTruthImage, PredictionImage, Predictions, average_precision
from evalkit.geometry import poses
from evalkit.scoring.breakdown import by_criterion, by_threshold, by_visibility, image_rows, pose_errors
from evalkit.scoring.evaluation import Subject
from evalkit.scoring.rules import Settings

RULES = [{}, {"protocol": "coco"}, {"threshold": 0.05, "min_visibility": 0.3}, {"max_results": 3}]


def taken_apart(predictions, truth, rules):
    result = average_precision(predictions, truth, **rules)
    return result, Subject.of(predictions, truth, result.settings)


@pytest.mark.parametrize("rules", RULES, ids=str)
def test_the_evaluation_s_own_criterion_and_threshold_give_its_own_ap(symmetric_model, make_crowd, rules):
    result, subject = taken_apart(*make_crowd(symmetric_model, 1), rules)
    assert dict(by_threshold(subject, result.settings))[result.settings.threshold] == pytest.approx(
        result.ap, abs=1e-12
    )
    found = {entry.criterion: entry for entry in by_criterion(subject, result.settings)}
    assert found["sym"].ap == pytest.approx(result.ap, abs=1e-12)


def test_every_criterion_gives_what_an_evaluation_by_it_gives(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 2)
    _, subject = taken_apart(predictions, truth, {})
    for entry in by_criterion(subject, Settings()):
        if entry.ap is None:
            assert entry.criterion == "mspd"
            assert "camera" in entry.reason
        else:
            assert entry.ap == pytest.approx(average_precision(predictions, truth, entry.criterion).ap, abs=1e-12)


def test_criteria_that_need_points_say_so_where_there_are_none(plain_model, make_crowd):
    _, subject = taken_apart(*make_crowd(replace(plain_model, points=None), 0), {})
    found = {entry.criterion: entry for entry in by_criterion(subject, Settings())}
    assert found["sym"].ap is not None
    assert all(found[name].ap is None and "points" in found[name].reason for name in ("add", "adds", "mssd"))


def test_visibility_bins_hold_every_instance_once(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 3, images=20)
    result, subject = taken_apart(predictions, truth, {})
    bins = by_visibility(subject, result.settings)
    assert sum(entry.instances for entry in bins) == result.counts["instances"]
    of = {round(entry.low, 1): entry for entry in bins}
    assert {low for low, entry in of.items() if entry.instances} == {0.2, 0.5, 0.9}  # as make_crowd draws them
    assert all(np.isnan(entry.ap) for entry in bins if not entry.instances)


def test_ap_of_a_visibility_bin_is_that_of_the_images_that_show_one(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 4, images=20)
    _, subject = taken_apart(predictions, truth, {})
    found = next(entry for entry in by_visibility(subject, Settings()) if entry.low == 0.9)
    shown = [image for image in truth.images if (image.visibility == 0.9).any()]
    ids = {image.id for image in shown}
    part = replace(predictions, images=[image for image in predictions.images if image.id in ids])
    alone = average_precision(part, replace(truth, images=shown), min_visibility=0.9)
    assert found.ap == pytest.approx(alone.ap, abs=1e-12)


def one_image(model, cam_from_obj, hypotheses, visibility=1.0):
    truth = GroundTruth(model, [GroundTruthImage("a", None, cam_from_obj, np.full(len(cam_from_obj), visibility))])
    return Predictions(model.name, [PredictionImage("a", hypotheses, np.ones(len(hypotheses)))]), truth


def test_errors_are_those_put_in_modulo_symmetry(symmetric_model, make_equivalent):
    rng = np.random.default_rng(0)
    apart = poses.from_rotation_translation(poses.random_rotations(rng, 6), np.arange(18).reshape(6, 3) * 0.1)
    angle, shift = np.radians([0.1, 0.5, 1.0, 1.5, 2.0, 2.5]), np.linspace(1e-4, 2e-3, 6)
    if symmetric_model.symmetry.kind == "sphere":
        axis = np.tile([1.0, 0, 0], (6, 1))
    else:
        across = np.cross(symmetric_model.symmetry.axis, rng.normal(size=(6, 3)))
        axis = across / np.linalg.norm(across, axis=1, keepdims=True)
    turn = poses.from_axis_angle(axis, angle)
    centroid = symmetric_model.centroid
    moved = apart @ poses.from_rotation_translation(turn, centroid - turn @ centroid)
    moved[:, 0, 3] += shift
    hypotheses = make_equivalent(symmetric_model, moved, rng)
    errors = pose_errors(symmetric_model, average_precision(*one_image(symmetric_model, apart, hypotheses)))
    turned = np.zeros(6) if symmetric_model.symmetry.kind == "sphere" else angle
    np.testing.assert_allclose(errors.rotation, turned, atol=1e-7)
    np.testing.assert_allclose(errors.translation, shift, atol=1e-12)
    assert errors.right.all()


def test_a_pose_turned_over_is_seen_as_an_error_and_a_far_one_is_not(plain_model):
    at = poses.from_rotation_translation(np.eye(3)[None], [[0.0, 0.0, 0.5]])
    flip = np.diag([1.0, -1.0, -1.0])
    over = at @ poses.from_rotation_translation(flip, plain_model.centroid - flip @ plain_model.centroid)
    errors = pose_errors(plain_model, average_precision(*one_image(plain_model, at, over)))
    assert np.degrees(errors.rotation) == pytest.approx([180.0])
    assert not errors.right.any()
    far = at + 0.0
    far[:, 0, 3] += 0.6 * plain_model.diameter
    nothing = pose_errors(plain_model, average_precision(*one_image(plain_model, at, far)))
    assert (len(nothing.right), nothing.instances) == (0, 1)


def test_instances_too_hidden_to_be_asked_for_have_no_errors(plain_model):
    at = poses.from_rotation_translation(np.eye(3)[None], [[0.0, 0.0, 0.5]])
    errors = pose_errors(plain_model, average_precision(*one_image(plain_model, at, at, visibility=0.1)))
    assert (len(errors.right), errors.instances) == (0, 0)


@pytest.mark.parametrize("rules", RULES, ids=str)
def test_image_rows_are_all_images_worst_first_and_add_up_to_the_counts(plain_model, make_crowd, rules):
    predictions, truth = make_crowd(plain_model, 5, images=25)
    result = average_precision(predictions, truth, **rules)
    rows = image_rows(result, result, predictions)
    assert sorted(row.id for row in rows) == sorted(result.image_ids)
    known = [row.ap for row in rows if not np.isnan(row.ap)]
    assert known == sorted(known)
    assert not np.isnan([row.ap for row in rows[: len(known)]]).any()
    counts = result.counts
    assert sum(row.to_find for row in rows) == counts["instances_to_find"]
    for key in ("true", "false", "ignored", "missed"):
        assert sum(getattr(row, key) for row in rows) == counts[key]
