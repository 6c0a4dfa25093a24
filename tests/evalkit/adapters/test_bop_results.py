"""BOP's results file: a row is what BOP asks for, and what it cannot hold, or does not, is refused."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit import InputError
from evalkit.adapters.bop import results as bop_results
from evalkit.datasets.documents import PredictionImage, Predictions
from evalkit.geometry import poses

C4 = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # a quarter turn about z


def test_a_results_row_is_what_bop_asks_for(tmp_path):
    pose = poses.from_rotation_translation(C4, [0.1, -0.2, 0.75])
    image = PredictionImage("000048-000001", pose[None], np.array([0.5]), 0.125)
    bop_results.write_predictions(tmp_path / "results.csv", Predictions("bunny", [image]), object_id=7)
    header, row = (tmp_path / "results.csv").read_text().splitlines()
    assert header == "scene_id,im_id,obj_id,score,R,t,time"
    scene, im, obj, score, rotation, translation, time = row.split(",")
    assert (scene, im, obj, score, time) == ("48", "1", "7", "0.5", "0.125")
    np.testing.assert_allclose([float(x) for x in rotation.split()], C4.ravel(), atol=1e-15)
    np.testing.assert_allclose([float(x) for x in translation.split()], [100, -200, 750])


@pytest.mark.parametrize(
    ("predictions", "word"),
    [
        (Predictions("obj_000001", [PredictionImage("bunny_3", np.eye(4)[None], np.ones(1))]), "bunny_3"),
        (Predictions("bunny", []), "--object-id"),
        (Predictions("obj_000001", [], "world"), "frame"),
    ],
)
def test_what_bop_cannot_hold_is_refused(tmp_path, predictions, word):
    with pytest.raises(InputError, match=word):
        bop_results.write_predictions(tmp_path / "results.csv", predictions)
    assert not any(tmp_path.iterdir())


GOOD_ROW = "1,3,1,0.5,1 0 0 0 1 0 0 0 1,10 20 700,0.2"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "first line"),
        ("scene,image\n", "first line"),
        ("{}\n", "no rows"),
        ("{}\n1,3,1,0.5,1 0 0 0 1 0 0 0,10 20 700,0.2", "line 2.*9 finite numbers"),
        ("{}\n1,3,1,0.5,2 0 0 0 1 0 0 0 1,10 20 700,0.2", "line 2.*rotation"),
        ("{}\n1,3,1,nan,1 0 0 0 1 0 0 0 1,10 20 700,0.2", "line 2.*finite"),
        ("{}\n1,3,1,0.5,1 0 0 0 1 0 0 0 1,10 20 7e5,0.2", "line 2.*unit"),
        ("{}\none,3,1,0.5,1 0 0 0 1 0 0 0 1,10 20 700,0.2", "line 2"),
        ("{}\n1,3,1,0.5", "line 2"),
        (f"{{}}\n{GOOD_ROW}\n{GOOD_ROW[:-3]}0.9", "same time"),
        (f"{{}}\n{GOOD_ROW}\n{GOOD_ROW.replace('1,3,1', '1,3,2')}", "--object-id with one of 1, 2"),
    ],
)
def test_results_that_cannot_be_read_are_refused_by_line(tmp_path, text, word):
    (tmp_path / "results.csv").write_text(text.format(",".join(bop_results.COLUMNS)))
    with pytest.raises(InputError, match=rf"results\.csv.*{word}"):
        bop_results.read_predictions(tmp_path / "results.csv")
