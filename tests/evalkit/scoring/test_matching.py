"""Matching in flat arrays: pairs, the two rules, and their counts down the lists."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit import GroundTruthImage, PredictionImage
from evalkit.scoring.distances import Sym, for_criterion
from evalkit.scoring.matching import DUPLICATE, FALSE, IGNORED, TRUE, Crowd, close_pairs, match_greedy, match_mutual


def gather(predictions, truth, max_results=None):
    by_id = {image.id: image for image in predictions.images}
    return Crowd.gather([by_id.get(image.id) for image in truth.images], truth.images, 0.5, max_results)


@pytest.mark.parametrize("criterion", ["sym", "add", "adds"])
@pytest.mark.parametrize("at_once", [1, 7, 10**6])
def test_close_pairs_are_all_pairs_within_the_threshold(plain_model, make_crowd, monkeypatch, criterion, at_once):
    monkeypatch.setattr("evalkit.scoring.matching.PAIRS_AT_ONCE", at_once)
    crowd = gather(*make_crowd(plain_model, 3))
    distance = for_criterion(criterion, plain_model)
    pairs = close_pairs(crowd, distance, 0.008)
    found = set(zip(pairs.hypothesis.tolist(), pairs.instance.tolist(), strict=True))
    expected = {
        (h, i)
        for h in range(len(crowd.score))
        for i in range(len(crowd.to_find))
        if crowd.image[h] == crowd.instance_image[i] and distance(crowd.pose[[h]], crowd.instance_pose[[i]])[0] <= 0.008
    }
    assert found == expected
    assert len(expected) > 5


def test_hypotheses_are_sorted_by_score_and_cut_image_by_image(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 5)
    crowd = gather(predictions, truth, max_results=2)
    for number, image in enumerate(truth.images):
        mine = crowd.image == number
        given = next((p.score for p in predictions.images if p.id == image.id), np.zeros(0))
        assert crowd.score[mine].tolist() == sorted(given.tolist(), reverse=True)[:2]
        np.testing.assert_array_equal(given[crowd.row[mine]], crowd.score[mine])


@pytest.mark.parametrize("match", [match_mutual, match_greedy])
def test_outcomes_and_counts_agree(symmetric_model, make_crowd, match):
    for seed in range(5):
        crowd = gather(*make_crowd(symmetric_model, seed))
        pairs = close_pairs(crowd, Sym(symmetric_model), 0.008)
        matching = match(crowd, pairs)
        found = np.flatnonzero(matching.found_by >= 0)
        finder = matching.found_by[found]
        assert len(set(finder)) == len(finder)
        assert (matching.outcome[finder] == np.where(crowd.to_find[found], TRUE, IGNORED)).all()
        assert (np.isin(matching.outcome, (TRUE, IGNORED)).sum()) == len(found)
        assert ((matching.outcome == FALSE) == (matching.partner < 0)).all()
        last = np.flatnonzero(np.diff(crowd.image, append=-1))
        for kind, so_far in ((TRUE, matching.true_so_far), (IGNORED, matching.ignored_so_far)):
            per_image = np.bincount(crowd.image, matching.outcome == kind, crowd.images)
            np.testing.assert_array_equal(so_far[last], per_image[crowd.image[last]])


def test_a_nearer_hypothesis_of_lower_score_takes_the_match_over_in_the_mutual_rule_only(plain_model):

    near, nearer = np.eye(4), np.eye(4)
    near[0, 3], nearer[0, 3] = 0.004, 0.001
    hypotheses = PredictionImage("a", np.stack([near, nearer]), np.array([0.9, 0.5]))
    crowd = Crowd.gather([hypotheses], [GroundTruthImage("a", None, np.eye(4)[None], np.ones(1))], 0.5)
    pairs = close_pairs(crowd, Sym(plain_model), 0.01)
    assert match_mutual(crowd, pairs).outcome.tolist() == [DUPLICATE, TRUE]
    assert match_greedy(crowd, pairs).outcome.tolist() == [TRUE, DUPLICATE]
    assert match_mutual(crowd, pairs).true_so_far.tolist() == [1, 1]


def test_of_exact_copies_the_surer_one_is_right(plain_model):
    hypotheses = PredictionImage("a", np.tile(np.eye(4), (3, 1, 1)), np.array([0.2, 0.9, 0.9]))
    crowd = Crowd.gather([hypotheses], [GroundTruthImage("a", None, np.eye(4)[None], np.ones(1))], 0.5)
    outcome = match_mutual(crowd, close_pairs(crowd, Sym(plain_model), 0.01)).outcome
    assert (crowd.row.tolist(), outcome.tolist()) == ([1, 2, 0], [TRUE, DUPLICATE, DUPLICATE])


def test_the_greedy_rule_spends_no_hypothesis_on_a_hidden_instance_while_one_to_find_is_near(plain_model):
    beside = np.eye(4).copy()
    beside[0, 3] = 0.003
    truth = GroundTruthImage("a", None, np.stack([np.eye(4), beside]), np.array([0.1, 0.9]))
    hypotheses = PredictionImage("a", np.eye(4)[None], np.ones(1))
    crowd = Crowd.gather([hypotheses], [truth], 0.5)
    pairs = close_pairs(crowd, Sym(plain_model), 0.01)
    assert match_greedy(crowd, pairs).outcome.tolist() == [TRUE]
    assert match_mutual(crowd, pairs).outcome.tolist() == [IGNORED]
