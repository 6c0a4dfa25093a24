"""BOP's detection scores: the toolkit's rules one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from evalkit import GroundTruth, GroundTruthImage, InputError, PredictionImage, Predictions
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from evalkit.scoring.detection_ap import MILLIMETERS, detection_ap

CAMERA = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
BOX = trimesh.creation.box((0.02, 0.03, 0.06))
DIAGONAL = 0.07  # meters


@pytest.fixture
def box():
    return ObjectModel.from_mesh("box", BOX.vertices, BOX.faces)


def at(*x_mm):
    """Poses whose parts lie half a meter away, so many millimeters to the right: MSSD is the difference."""
    return poses.from_rotation_translation(np.eye(3), [[x / 1000, 0.0, 0.5] for x in x_mm])


def score(model, found, scores, truth, visibility, **options):
    image = GroundTruthImage("a", CAMERA, truth, np.array(visibility, float))
    estimates = PredictionImage("a", found, np.array(scores, float))
    return detection_ap(Predictions("box", [estimates]), GroundTruth(model, [image]), **options)


def test_every_name_of_2024_and_2025_is_there(box):
    found = score(box, at(0), [1], at(0), [1]).scores
    assert found == dict.fromkeys(
        ["bop24_mAP", "bop24_mAP_mssd", "bop24_mAP_mspd", "bop24_mAP_mssd_mm", "bop25_mAP", "bop25_mAP_mm"], 1.0
    )
    near = score(box, at(5.5), [1], at(0), [1])
    assert near.scores["bop25_mAP"] == near.scores["bop24_mAP_mssd"] == 0.9
    assert near.scores["bop25_mAP_mm"] == 0.8
    assert [mm for mm, ap in near.mssd_mm.items() if ap == 1.0] == [mm for mm in MILLIMETERS if mm > 5.5]


def test_a_diameter_is_the_largest_distance_of_two_vertices_unless_bop_states_one(box):
    assert score(box, at(0), [1], at(0), [1]).diameter == pytest.approx(DIAGONAL)
    stated = replace(box, notes={"bop_diameter": 0.05})
    found = score(stated, at(5.5), [1], at(0), [1])
    assert (found.diameter, found.mssd_mm[6.0]) == (0.05, 1.0)
    assert next(round(d, 2) for d, ap in found.mssd.items() if ap == 1.0) == 0.15
    with pytest.raises(InputError, match="bop_diameter"):
        score(replace(box, notes={"bop_diameter": "wide"}), at(0), [1], at(0), [1])


def test_an_estimate_takes_the_nearest_instance_even_where_a_hidden_one_is_nearer(box):
    taken = score(box, at(3), [1], at(0, 5), [1, 0.05])
    assert taken.mssd_mm[20.0] == 0.0  # it is ignored, and the visible one is missed
    assert score(box, at(2), [1], at(0, 5), [1, 0.05]).mssd_mm[20.0] == 1.0


def test_an_instance_exactly_a_tenth_visible_is_asked_for(box):
    assert score(box, at(0), [1], at(0, 100), [1, 0.1]).mssd_mm[20.0] == pytest.approx(51 / 101)
    assert score(box, at(0), [1], at(0, 100), [1, 0.1 - 1e-7]).mssd_mm[20.0] == 1.0


def test_of_estimates_with_one_score_the_first_given_comes_first(box):
    wrong_first = score(box, at(200, 0), [1, 1], at(0), [1])
    wrong_last = score(box, at(0, 200), [1, 1], at(0), [1])
    assert (wrong_first.mssd_mm[20.0], wrong_last.mssd_mm[20.0]) == (0.5, 1.0)


def test_only_so_many_best_estimates_of_an_image_count(box):
    found, scores = at(*[200.0] * 100, 0.0), [*[1.0] * 100, 0.5]
    assert score(box, found, scores, at(0), [1]).mssd_mm[20.0] == 0.0
    assert score(box, found, scores, at(0), [1], max_results=101).mssd_mm[20.0] == pytest.approx(1 / 101)
    xyzibd = replace(box, notes={"bop_dataset": "xyzibd"})
    assert score(xyzibd, found, scores, at(0), [1]).max_results == 200


def test_recall_is_compared_with_the_floating_hundredths(box):
    truth = at(*(100.0 * np.arange(200)))
    found = score(box, truth[:140], np.ones(140), truth, np.ones(200), max_results=200)
    assert found.mssd_mm[20.0] == pytest.approx(70 / 101)  # and not 71: 140 / 200 < np.linspace(0, 1, 101)[70]


def test_images_that_do_not_show_the_object_do_not_count(box):
    images = [
        GroundTruthImage("a", CAMERA, at(0), np.ones(1)),
        GroundTruthImage("b", CAMERA, np.zeros((0, 4, 4)), np.zeros(0)),
    ]
    alarm = PredictionImage("b", at(0), np.array([2.0]))
    found = Predictions("box", [PredictionImage("a", at(0), np.ones(1)), alarm])
    assert detection_ap(found, GroundTruth(box, images)).scores["bop25_mAP"] == 1.0


def test_nothing_predicted_scores_zero_and_nothing_to_find_is_refused(box):
    nothing = np.zeros((0, 4, 4))
    assert set(score(box, nothing, [], at(0), [1]).scores.values()) == {0.0}
    with pytest.raises(InputError, match="10 % visible"):
        score(box, at(0), [1], at(0), [0.05])


def test_images_without_a_camera_are_refused(plain_model, make_crowd):
    with pytest.raises(InputError, match="camera"):
        detection_ap(*make_crowd(plain_model, 2))


def test_the_rules_are_stated(box):
    document = score(box, at(0), [1], at(0), [1]).to_json()
    for word in ("eval_bop24_pose", "70 mm", "best 100", "10 %", "the mesh's 8 vertices", "takes it for infinite"):
        assert word in document["protocol"]
    assert document["mssd"] == dict.fromkeys(
        ["0.05", "0.1", "0.15", "0.2", "0.25", "0.3", "0.35", "0.4", "0.45", "0.5"], 1.0
    )
