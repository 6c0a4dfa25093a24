"""What prediction goes without when a part of the network is switched off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from posenet.network.depth_input import intrinsics_of
from posenet.network.predict_options import PredictOptions
from posenet.prediction.predictor import PredictedPoses, Predictor


@pytest.fixture(scope="module")
def view(debug_shards: Path) -> View:
    return ShardDataset(debug_shards)[0]


def predictor(run_folder: Path, options: PredictOptions) -> Predictor:
    return Predictor.load(run_folder, "cpu", options=options)


def poses_a_detection(found: PredictedPoses) -> int:
    return int(np.bincount(found.detection).max())


def test_the_default_switches_nothing_off(run_folder: Path, view: View) -> None:
    whole = Predictor.load(run_folder, "cpu")
    again = predictor(run_folder, PredictOptions())
    np.testing.assert_array_equal(
        again.predict(view.depth, view.camera).cam_from_obj, whole.predict(view.depth, view.camera).cam_from_obj
    )


@pytest.mark.parametrize("most", [1, 3])
def test_so_many_hypotheses_a_detection_at_most(run_folder: Path, view: View, most: int) -> None:
    few = predictor(run_folder, PredictOptions(hypotheses=most)).predict(view.depth, view.camera)
    whole = predictor(run_folder, PredictOptions()).predict(view.depth, view.camera)
    assert poses_a_detection(few) <= most < poses_a_detection(whole)
    assert set(few.boxes[:, 0]) == set(whole.boxes[:, 0])


def test_the_precision_is_the_users_and_costs_little(run_folder: Path, view: View) -> None:
    exact, rounded = (Predictor.load(run_folder, "cpu", precision=name) for name in ("float32", "bfloat16"))
    assert (exact.precision, rounded.precision) == ("float32", "bfloat16")
    assert Predictor.load(run_folder, "cpu").precision in (exact.precision, rounded.precision)
    best, other = (one.predict(view.depth, view.camera) for one in (exact, rounded))
    assert not np.array_equal(best.score[:3], other.score[:3])
    assert abs(best.score[0] - other.score[0]) < 0.1
    with pytest.raises(InputError, match="--precision 'half' is not known; use one of auto, float32, bfloat16"):
        Predictor.load(run_folder, "cpu", precision="half")


def test_without_registration_the_score_is_the_confidence(run_folder: Path, view: View) -> None:
    alone = predictor(run_folder, PredictOptions(registration=False))
    network = predictor(run_folder, PredictOptions()).fast
    depth = torch.from_numpy(view.depth)[None]
    intrinsics = intrinsics_of(view.camera)[None]
    with torch.no_grad(), network.predicting(alone.fast.bf16):
        (proposals,) = network.propose(network.encode(depth, intrinsics))
        scored = network.score(proposals)
    confidence = scored.confidence.sigmoid().sort(descending=True).values.numpy()
    found = alone.predict(view.depth, view.camera)
    np.testing.assert_allclose(found.score, confidence, atol=1e-4)


def test_without_offset_the_box_center_stands_in(run_folder: Path, view: View) -> None:
    found = predictor(run_folder, PredictOptions(offset=False)).predict(view.depth, view.camera)
    model = predictor(run_folder, PredictOptions()).model
    projected = view.camera.project(model.centers(found.cam_from_obj))
    middle = found.boxes.reshape(-1, 2, 2).mean(1) - 0.5  # integer pixels are centers, boxes count from corners
    np.testing.assert_allclose(projected, middle, atol=0.02)
