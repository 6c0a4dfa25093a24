"""Figures show what the network says."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from posenet.figures import angle_bins, draw_figures, relations
from posenet.figures.looked_at import LookedAt, look_at
from posenet.models.model_file import load_model
from posenet.network.registration import RELATION_NAMES
from posenet.prediction.predictor import Predictor


@pytest.fixture(scope="module")
def looked(run_folder: Path, debug_shards: Path) -> LookedAt:
    return look_at(load_model(run_folder).network, ShardDataset(debug_shards)[0])


def test_what_is_drawn_is_what_is_predicted(looked: LookedAt, run_folder: Path) -> None:
    predictor = Predictor.load(run_folder, "cpu", precision="float32")
    found = predictor.predict(looked.view.depth, looked.view.camera)
    np.testing.assert_allclose(np.sort(looked.score)[::-1], found.score, atol=1e-4)


def test_matrices_of_relations_hold_each_pairs_features(looked: LookedAt) -> None:
    rows = list(range(len(looked.score)))
    matrices = dict(zip(RELATION_NAMES, relations._matrices(looked, rows), strict=True))
    np.testing.assert_allclose(np.diag(matrices["box IoU"]), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.diag(matrices["distance"]), 0.0, atol=1e-6)
    mutual = np.isfinite(matrices["dx"]) & np.isfinite(matrices["dx"].T)  # each has only so many neighbors
    assert mutual.sum() > len(rows)
    np.testing.assert_allclose(matrices["own score"][mutual], matrices["other's score"].T[mutual])
    np.testing.assert_allclose(matrices["dx"][mutual], -matrices["dx"].T[mutual], atol=1e-6)


def test_a_turn_of_a_turns_the_view_in_the_image(looked: LookedAt) -> None:
    surface = angle_bins._Surface(looked.network)
    upright, turned = (surface.seen(a, 0.9, 0.4) < 1 for a in (0.0, np.pi / 2))
    overlap = (np.rot90(upright, -1) & turned).sum() / (np.rot90(upright, -1) | turned).sum()
    assert overlap > 0.9
    assert (upright & turned).sum() / (upright | turned).sum() < 0.9


def test_three_pictures_are_written(run_folder: Path, debug_shards: Path, tmp_path: Path) -> None:
    paths = draw_figures(load_model(run_folder).network, debug_shards, tmp_path / "figures")
    assert [path.name for path in paths] == ["bins.png", "hypotheses.png", "relations.png"]
    for path in paths:
        picture = cv2.imread(str(path))
        assert picture is not None and picture.std() > 5


def test_a_frame_that_is_not_there_is_refused(run_folder: Path, debug_shards: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--frame 99"):
        draw_figures(load_model(run_folder).network, debug_shards, tmp_path, 99)


def test_an_image_of_holes_has_nothing_to_draw(looked: LookedAt) -> None:
    import dataclasses

    empty = dataclasses.replace(looked.view, depth_raw=np.zeros_like(looked.view.depth_raw))
    with pytest.raises(InputError, match="finds nothing"):
        look_at(looked.network, empty)
