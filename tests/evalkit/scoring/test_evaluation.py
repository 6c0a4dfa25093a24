"""average_precision: against a plain reference, and laws that any honest score obeys."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit import GroundTruth, GroundTruthImage, InputError, PredictionImage, Predictions, average_precision
from evalkit.geometry import poses
from evalkit.scoring.matching import TRUE

plain = runpy.run_path(str(Path(__file__).with_name("reference_protocol.py")))
PROTOCOLS = ("sileane", "sileane-toolbox", "coco")


def scenes_of(predictions, truth, toolbox=False, min_visibility=0.5):
    by_id = {image.id: image for image in predictions.images}
    scenes = []
    for image in truth.images:
        if image.id in by_id or not toolbox:
            found = by_id.get(image.id)
            hypotheses = [] if found is None else list(zip(found.cam_from_obj, found.score.tolist(), strict=True))
            scenes.append((hypotheses, list(zip(image.cam_from_obj, image.visibility >= min_visibility, strict=True))))
    return scenes


def as_predictions(truth, score=None):
    rng = np.random.default_rng(5)
    images = [
        PredictionImage(i.id, i.cam_from_obj, rng.random(len(i.visibility)) if score is None else score(i))
        for i in truth.images
    ]
    return Predictions(truth.object.name, images)


@pytest.mark.parametrize("max_results", [None, 2])
@pytest.mark.parametrize("protocol", ["sileane", "sileane-toolbox"])
def test_agrees_with_the_plain_reference_in_every_curve_point(symmetric_model, make_crowd, protocol, max_results):
    toolbox = protocol == "sileane-toolbox"
    for seed in range(8):
        predictions, truth = make_crowd(symmetric_model, seed)
        result = average_precision(predictions, truth, protocol=protocol, max_results=max_results, threshold=0.08)
        expected = plain["evaluate"](
            scenes_of(predictions, truth, toolbox),
            lambda a, b: plain["sym_distance"](a, b, symmetric_model, toolbox),
            0.008,
            max_results,
        )
        curve = np.array(expected["curve"])
        np.testing.assert_array_equal(result.curve.score, curve[:, 0])
        np.testing.assert_allclose(result.curve.precision, curve[:, 1], atol=1e-12)
        np.testing.assert_allclose(result.curve.recall, curve[:, 2], atol=1e-12)
        np.testing.assert_allclose(result.image_ap, expected["scene_ap"], atol=1e-12)
        assert result.ap == pytest.approx(expected["ap"], abs=1e-12)


def test_recall_at_a_precision_is_the_highest_but_in_the_toolbox_the_last(plain_model, make_crowd):
    figures = []
    for seed in range(12):
        crowd = make_crowd(plain_model, seed)
        ours, toolbox = (average_precision(*crowd, protocol=name) for name in ("sileane", "sileane-toolbox"))
        assert ours.recall_at_precision_50 == ours.curve.recall_at_precision(0.5)
        assert toolbox.recall_at_precision_50 == toolbox.curve.recall_at_last_precision(0.5)
        figures.append((toolbox.recall_at_precision_50, toolbox.curve.recall_at_precision(0.5)))
    assert any(last < highest for last, highest in figures)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_ground_truth_given_as_predictions_scores_exactly_one(symmetric_model, make_crowd, protocol):
    for seed in range(4):
        _, truth = make_crowd(symmetric_model, seed)
        result = average_precision(as_predictions(truth), truth, protocol=protocol)
        assert (result.ap, result.map, result.best_f1) == (1.0, 1.0, 1.0)
        assert result.recall_at_precision_99 == result.recall_at_precision_50 == 1.0
        assert result.counts["false"] == result.counts["missed"] == 0


@pytest.mark.parametrize("protocol", ["sileane", "coco"])
def test_equivalent_poses_of_the_ground_truth_score_exactly_one(symmetric_model, make_crowd, make_equivalent, protocol):
    rng = np.random.default_rng(1)
    _, truth = make_crowd(symmetric_model, 3)
    turned = [replace(i, cam_from_obj=make_equivalent(symmetric_model, i.cam_from_obj, rng)) for i in truth.images]
    result = average_precision(as_predictions(replace(truth, images=turned)), truth, protocol=protocol)
    assert result.ap == result.map == result.best_f1 == 1.0


@pytest.mark.parametrize("criterion", ["sym", "add", "adds"])
def test_ground_truth_scores_one_by_every_criterion(plain_model, make_crowd, criterion):
    _, truth = make_crowd(plain_model, 0)
    assert average_precision(as_predictions(truth), truth, criterion=criterion).ap == 1.0


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_order_of_images_and_a_monotone_change_of_scores_change_nothing(symmetric_model, make_crowd, protocol):
    predictions, truth = make_crowd(symmetric_model, 2)
    before = average_precision(predictions, truth, protocol=protocol)
    reordered = replace(
        predictions, images=[replace(i, score=np.exp(7 * i.score) - 100) for i in reversed(predictions.images)]
    )
    after = average_precision(reordered, replace(truth, images=truth.images[::-1]), protocol=protocol)
    assert after.ap == pytest.approx(before.ap, abs=1e-12)
    assert after.counts == before.counts


def test_a_common_motion_of_camera_changes_nothing(symmetric_model, make_crowd):
    predictions, truth = make_crowd(symmetric_model, 4)
    move = poses.from_rotation_translation(poses.from_axis_angle([1.0, 2.0, 3.0], 1.0), [0.1, -0.2, 0.3])
    moved = [
        replace(doc, images=[replace(i, cam_from_obj=move @ i.cam_from_obj) for i in doc.images])
        for doc in (predictions, truth)
    ]
    assert average_precision(*moved).ap == pytest.approx(average_precision(predictions, truth).ap, abs=1e-12)


def test_an_image_without_predictions_counts_as_having_none_unless_the_toolbox_skips_it(plain_model):
    pose = np.eye(4)[None]
    truth = GroundTruth(plain_model, [GroundTruthImage(name, None, pose, np.ones(1)) for name in "ab"])
    predictions = Predictions(plain_model.name, [PredictionImage("a", pose, np.ones(1))])
    result = average_precision(predictions, truth)
    assert result.ap == 0.5
    assert result.missing_images == ["b"]
    assert average_precision(predictions, truth, protocol="sileane-toolbox").ap == 1.0


def test_nothing_to_find_and_nothing_predicted_is_perfect_but_a_false_alarm_is_not(plain_model):
    empty = GroundTruthImage("a", None, np.zeros((0, 4, 4)), np.zeros(0))
    truth = GroundTruth(plain_model, [empty])
    silent = Predictions(plain_model.name, [])
    assert average_precision(silent, truth).ap == 1.0
    alarm = Predictions(plain_model.name, [PredictionImage("a", np.eye(4)[None], np.ones(1))])
    assert average_precision(alarm, truth).ap == 0.0


def test_a_duplicate_is_false_and_an_occluded_match_is_ignored(plain_model):
    both = np.tile(np.eye(4), (2, 1, 1))
    both[:, 2, 3] = 0.5, 0.9
    truth = GroundTruth(plain_model, [GroundTruthImage("a", None, both, np.array([1.0, 0.1]))])
    hypotheses = PredictionImage("a", both[[0, 0, 1]], np.array([0.9, 0.8, 0.7]))
    result = average_precision(Predictions(plain_model.name, [hypotheses]), truth)
    assert {k: result.counts[k] for k in ("true", "duplicates", "ignored")} == {
        "true": 1, "duplicates": 1, "ignored": 1,
    }  # fmt: skip
    assert result.images()[0].outcome[0] == TRUE
    assert result.images()[0].ignored.tolist() == [False, True]
    assert result.curve.precision.tolist() == [1.0, 0.5, 0.5]


def test_outcomes_come_in_the_order_of_the_documents(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 7)
    result = average_precision(predictions, truth, max_results=3)
    by_id = {image.id: image for image in predictions.images}
    for image in result.images():
        given = by_id[image.id].score if image.id in by_id else np.zeros(0)
        assert len(image.outcome) == len(given)
        assert (image.outcome >= 0).sum() == min(3, len(given))
        if len(given) > 3:
            assert given[image.outcome >= 0].min() >= given[image.outcome < 0].max()
    assert sum((image.outcome == TRUE).sum() for image in result.images()) == result.counts["true"]
    assert sum(image.missed.sum() for image in result.images()) == result.counts["missed"]


def test_visibility_limits_hold_in_spite_of_rounding(plain_model):
    pose = np.tile(np.eye(4), (4, 1, 1))
    visibility = np.array([1 - 0.3, 0.7, float(np.float32(0.7)), 0.69])
    truth = GroundTruth(plain_model, [GroundTruthImage("a", None, pose, visibility)])
    assert average_precision(as_predictions(truth), truth, min_visibility=0.7).counts["instances_to_find"] == 3


def test_the_result_states_its_rules(plain_model, make_crowd):
    result = average_precision(*make_crowd(plain_model, 0), min_visibility=0.6, threshold=0.05, max_results=9)
    document = result.to_json()
    for word in ("Sym", "60 %", "0.05 diameters", "5 mm", "sileane", "none", "best 9"):
        assert word in document["protocol"]
    assert document["threshold"] == {"diameters": 0.05, "metres": pytest.approx(0.005)}
    assert {"ap", "map", "best_f1", "recall_at_precision_99", "recall_at_precision_50", "counts"} <= document.keys()


FAR = np.eye(4)[None] + 400.0 * np.eye(4)[2][:, None] * np.eye(4)[3]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"object": "other"}, ["other", "thing-none"]),
        ({"object": {"name": "thing-none", "diameter": 100.0}}, ["diameter", "100"]),
        ({"images": [PredictionImage("nobody", FAR, np.ones(1))]}, ["nobody"]),
        ({"frame": "world"}, ["world", "camera"]),
        ({"images": [PredictionImage("i0", FAR, np.ones(1))]}, ["i0", "millimeters"]),
    ],
)
def test_documents_that_do_not_belong_together_are_refused(plain_model, make_crowd, changes, words):
    predictions, truth = make_crowd(plain_model, 0)
    with pytest.raises(InputError) as caught:
        average_precision(replace(predictions, source="p.json", **changes), truth)
    assert all(word in str(caught.value) for word in ["p.json", *words])


@pytest.mark.parametrize(
    ("predicted", "true", "agree"),
    [
        ("gear", "gear", True), ("gear", "", True), ("", "gear", True), ("", "", True),
        ("gear", "bolt", False), ("obj_000001", "obj_000002", False), ("obj_000001", "gear", True),
        ("gear", "obj_000007", True),
    ],
)  # fmt: skip
def test_only_names_that_were_stated_and_differ_refuse_a_pair(plain_model, make_crowd, predicted, true, agree):
    predictions, truth = make_crowd(plain_model, 0)
    pair = replace(predictions, object=predicted), replace(truth, object=replace(truth.object, name=true))
    if agree:
        average_precision(*pair)
    else:
        with pytest.raises(InputError, match=f"'{predicted}'.*'{true}'"):
            average_precision(*pair)


@pytest.mark.parametrize(
    "settings",
    [
        {"criterion": "iou"}, {"protocol": "voc"}, {"threshold": 0.0}, {"threshold": float("nan")},
        {"min_visibility": 50.0}, {"max_results": 0}, {"criterion": "add", "protocol": "sileane-toolbox"},
    ],
)  # fmt: skip
def test_settings_without_meaning_are_refused(plain_model, make_crowd, settings):
    with pytest.raises(InputError):
        average_precision(*make_crowd(plain_model, 0), **settings)


def test_figures_at_a_confidence_are_those_of_the_list_cut_there(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 0)
    result = average_precision(predictions, truth)
    for score in (0.0, 0.5, 0.55, 0.875):
        cut = [
            replace(i, cam_from_obj=i.cam_from_obj[i.score >= score], score=i.score[i.score >= score])
            for i in predictions.images
        ]
        alone = average_precision(replace(predictions, images=cut), truth).curve
        expected = (alone.precision[-1], alone.recall[-1], alone.f1[-1])
        assert result.at_confidence(score) == pytest.approx(expected, abs=1e-12)


def with_origin_moved(model, offset):
    """The same object in a file whose origin lies elsewhere, and what takes its poses there."""
    new_from_old = poses.from_rotation_translation(np.eye(3), offset)
    old_from_new = poses.invert(new_from_old)
    inertial = model.inertial_from_obj @ old_from_new
    moved = replace(model, centroid=model.centroid + offset, inertial_from_obj=inertial, points=model.points + offset)
    return moved, old_from_new


@pytest.mark.parametrize("criterion", ["sym", "add", "adds", "mssd"])
def test_the_files_origin_changes_no_score(symmetric_model, make_crowd, criterion):
    moved, old_from_new = with_origin_moved(symmetric_model, np.array([3.0, -2.0, 150.0]))
    predictions, truth = make_crowd(symmetric_model, 3)
    same = [
        type(document)(name, [replace(i, cam_from_obj=i.cam_from_obj @ old_from_new) for i in document.images])
        for document, name in ((predictions, moved.name), (truth, moved))
    ]
    expected = average_precision(predictions, truth, criterion=criterion)
    result = average_precision(*same, criterion=criterion)
    np.testing.assert_allclose(result.image_ap, expected.image_ap, atol=1e-9)


def test_millimeters_are_refused_wherever_the_files_origin_is(plain_model):
    offset = np.array([0.0, 0.0, -60.0])
    moved, _ = with_origin_moved(plain_model, offset)
    pose = poses.from_rotation_translation(np.eye(3), [[0.0, 0.0, 0.6] - offset])
    truth = GroundTruth(moved, [GroundTruthImage("i0", None, pose, np.ones(1))])
    in_millimeters = poses.from_rotation_translation(np.eye(3), [[0.0, 0.0, 600.0] - offset])
    wrong = Predictions(moved.name, [PredictionImage("i0", in_millimeters, np.ones(1))])
    with pytest.raises(InputError, match="millimeters"):
        average_precision(wrong, truth)
