"""The error budget: what is replaced by the truth is true, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from posenet.coding.class_bins import Bins
from posenet.prediction.predictor import PredictedPoses, Predictor

CORNERS = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.08, 0], [0, 0, 0.06]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.fixture(scope="module")
def budget(load_benchmark):
    return load_benchmark("error_budget")


@pytest.fixture(scope="module")
def study(budget, run_folder, debug_shards):
    return budget.Study(run_folder, debug_shards, 3, "cpu")


def test_without_replacement_the_poses_are_those_of_posenet_predict(study, run_folder):
    for refine in (False, True):
        predictor = Predictor.load(run_folder, "cpu", refine)
        for frame in study.frames:
            view = study.dataset[frame]
            expected, found = predictor.predict(view.depth, view.camera), study._predict(int(refine), frame, ())
            np.testing.assert_array_equal(found.cam_from_obj, expected.cam_from_obj)
            np.testing.assert_array_equal(found.score, expected.score)


def test_with_everything_true_every_instance_that_is_seen_is_found(study):
    row = study.row("all of it true")
    assert row.ap[0] > 0.99
    assert row.ap[1] > 0.9  # the refinement of a coarse image may lose one


def test_true_boxes_and_poses_give_the_true_poses(study, budget):
    frame = study.frames[0]
    labels = study.dataset[frame].instances
    asked = labels[labels.visibility_returned >= 0.2]
    found = study._predict(0, frame, ("boxes", *budget.POSE_STAGES))
    for pose in asked.cam_from_obj:
        distance = np.abs(found.cam_from_obj - pose).reshape(len(found.score), -1).max(1)
        assert distance.min() < 1e-3


def test_a_truth_between_two_bins_is_read_back_exactly(budget):
    value = torch.linspace(0.01, 6.27, 200)
    for bins in (Bins(30, 0.0, 2 * np.pi, circular=True), Bins(40, -1.0, 7.0)):
        read, mass = bins.peaks(budget._certain(bins, value).log_softmax(-1), 1, interpolate=True)
        np.testing.assert_allclose(read[:, 0], value, atol=1e-4)
        np.testing.assert_allclose(mass, 0.0, atol=1e-4)


def test_true_ranking_puts_one_right_hypothesis_an_instance_first(budget):
    model = ObjectModel.from_mesh("wedge", CORNERS, FACES)
    truth = poses.from_rotation_translation(np.eye(3), [[0.0, 0, 1], [0.3, 0, 1]])
    shifts = [[0.004, 0, 1], [0.002, 0, 1], [0.3, 0.001, 1], [0.9, 0, 1]]
    cam_from_obj, score = poses.from_rotation_translation(np.eye(3), shifts), np.array([0.9, 0.5, 0.1, 0.8])
    found = PredictedPoses(cam_from_obj, score, boxes=np.zeros((4, 4)), detection=np.arange(4), time_s=0.0)
    ranked = budget.ranked_by_truth(found, truth, model)
    np.testing.assert_allclose(ranked.score, [0.9, 1.5, 1.1, 0.8])  # the nearer of two to an instance; the far one not


def test_the_table_has_a_row_for_every_stage_and_band(budget):
    rows = [budget.Budget(name, (0.5, 0.75), ([0.1] * 8, [np.nan] * 8)) for name in budget.ROWS]
    lines = list(budget.table(iter(rows)))
    assert sum(line.startswith("| true rotation") for line in lines) == 3
    assert "| true rotation | 0.500 | +0.000 | 0.750 | +0.000 |" in lines
    assert any("90–100 %" in line for line in lines)


def test_a_model_of_another_object_is_refused(budget, run_folder, tmp_path):
    with pytest.raises(InputError):
        budget.Study(run_folder, tmp_path, 3, "cpu")
