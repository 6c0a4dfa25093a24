"""The judge adds up what it hears, and no two poses that cannot both be are both believed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from evalkit.errors import InputError
from posenet.refinement import appearance, judge
from posenet.refinement.judge import Judge, Regression, probability, shipped_judge
from posenet.refinement.neighbors import neighbor_columns, without_impossible_pairs
from posenet.refinement.pose_evidence import company, search_columns


def test_log_odds_are_the_sum_of_what_each_input_says_and_none_shouts() -> None:
    regression = Regression(-1.0, {"near": (0.5, 0.1, 2.0), "hidden": (0.0, 0.5, -1.0)})
    columns = {"near": np.array([0.5, 0.6, 9.0]), "hidden": np.array([0.0, 0.5, -9.0]), "other": np.zeros(3)}
    limit = judge.FARTHEST
    expected = [-1.0, -1.0 + 2.0 - 1.0, -1.0 + 2 * limit + limit]
    np.testing.assert_allclose(regression.logit(columns), expected, atol=1e-12)
    np.testing.assert_allclose(probability(np.array([0.0, np.log(9.0)])), [0.5, 0.9])


def test_the_shipped_judge_is_small_and_hears_what_there_is() -> None:
    path = Path(judge.__file__).with_name("judge.json")
    assert path.stat().st_size < 8192
    alone = set(shipped_judge().alone.terms)
    assert alone <= {*appearance.NAMES, "prior", "strayed", "margin", "stable", "company", "evidence"}
    nothing = np.zeros(1)
    assert set(shipped_judge().among.terms) <= set(
        neighbor_columns(nothing, nothing, nothing, nothing, nothing > 0, np.zeros((0, 2), np.int64), np.zeros(0))
    )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "binpose-judge/9"}, r"judge.json: the field 'format' is not 'binpose-judge/1'"),
        ({"among": None}, r"judge.json.among: expected"),
        ({"mood": 1}, r"judge.json: the field 'mood' is unknown"),
    ],
)
def test_what_is_no_judge_is_refused(tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    document = json.loads(Path(judge.__file__).with_name("judge.json").read_text())
    (tmp_path / "judge.json").write_text(json.dumps(document | change))
    with pytest.raises(InputError, match=sentence):
        Judge.read(tmp_path / "judge.json")


def test_of_poses_that_cannot_both_be_at_most_one_is_believed() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        score = rng.uniform(0, 1, 12)
        pairs = np.array([(i, j) for i in range(12) for j in range(i) if rng.random() < 0.3]).reshape(-1, 2)
        left = without_impossible_pairs(score, pairs)
        assert (left[pairs].sum(1) <= 1.0 + 1e-12).all()
        assert (left <= score).all() and left[score.argmax()] == score.max()
        alone = np.setdiff1d(np.arange(12), pairs)
        assert (left[alone] == score[alone]).all()
    assert (without_impossible_pairs(score, np.zeros((0, 2), np.int64)) == score).all()


def test_margin_and_stability_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(1)
    tried, evidence, of = rng.uniform(0, 3, 60), rng.uniform(0, 1, 60), np.arange(60) % 7
    chosen = np.array([max(np.flatnonzero(of == k), key=lambda row: evidence[row]) for k in range(7)])
    found = search_columns(tried[chosen], evidence[chosen], tried, evidence, of, lambda a, b: abs(a - b))
    for k in range(7):
        away = abs(tried - tried[chosen[k]])
        others = evidence[(of == k) & (away > 1.0)]
        margin = min(evidence[chosen[k]] - others.max(), 1.0) if len(others) else 1.0
        assert found["margin"][k] == pytest.approx(margin)
        assert found["stable"][k] == pytest.approx((away[of == k] < 0.5).mean())


def test_company_counts_who_came_to_the_same_pose() -> None:
    pairs = np.array([[0, 1], [0, 2], [1, 3]])
    np.testing.assert_allclose(np.expm1(company(5, pairs, np.array([0.2, 0.9, 1.5]))), [2, 1, 1, 0, 0])


def test_only_better_poses_that_count_push_others_aside() -> None:
    alone = np.array([3.0, 1.0, -2.0])
    pairs, deep = np.array([[0, 1], [1, 2], [0, 2]]), np.array([0.5, 9.0, 2.0])
    zeros = np.zeros(3)
    found = neighbor_columns(alone, zeros, zeros, zeros, np.array([True, False, True]), pairs, deep)
    sure = probability(alone)
    np.testing.assert_allclose(found["inside a better one"], [0.0, 0.5 * sure[0], 2.0 * sure[0]])
