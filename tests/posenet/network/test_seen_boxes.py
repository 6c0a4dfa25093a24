"""Where hypotheses would be seen, and that registration hears what the image shows there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.geometry import poses
from posenet.config import preset, with_options
from posenet.models.model_file import load_model
from posenet.network.depth_input import intrinsics_of
from posenet.network.pose_network import PoseNetwork
from posenet.network.seen_boxes import outermost_points, pooled_features, seen_boxes
from posenet.network.stages import Proposals


def test_the_box_is_that_of_the_whole_projected_surface() -> None:
    rng = np.random.default_rng(0)
    surface = rng.standard_normal((4000, 3)) * [0.05, 0.02, 0.03]
    surface /= np.maximum(1.0, np.linalg.norm(surface / [0.1, 0.04, 0.06], axis=1))[:, None]
    rotation = torch.from_numpy(poses.random_rotations(rng, 50)).float()
    center = torch.from_numpy(rng.uniform([-0.2, -0.2, 0.6], [0.2, 0.2, 1.2], (50, 3))).float()
    intrinsics = torch.tensor([300.0, 310.0, 160.0, 120.0])
    exact = seen_boxes(torch.from_numpy(surface).float(), rotation, center, intrinsics, 0.01)
    found = seen_boxes(outermost_points(surface), rotation, center, intrinsics, 0.01)
    sides = exact[:, 2:] - exact[:, :2]
    assert ((found - exact).abs() <= 0.06 * sides.repeat(1, 2)).all()


def test_features_are_pooled_from_within_the_box() -> None:
    features = torch.arange(40.0).expand(2, 30, 40).contiguous()  # each cell holds its column
    boxes = torch.tensor([[80.0, 0, 160, 240], [160, 80, 176, 96]])
    left, small = pooled_features(features, boxes, 2, 8).reshape(2, 2, 2, 2)[:, 0, 0]
    torch.testing.assert_close(left, torch.tensor([12.0, 17.0]))
    torch.testing.assert_close(small, torch.tensor([20.0, 21.0]))


@pytest.fixture(scope="module")
def seeing(run_folder: Path) -> PoseNetwork:
    """The session's network with a registration that sees, untrained."""
    trained = load_model(run_folder).network
    torch.manual_seed(0)
    config = with_options(preset("debug"), "network", registration_cells=3)
    network = PoseNetwork(config, trained.model, trained.depth_range, trained.camera)
    other = {name: value for name, value in trained.state_dict().items() if not name.startswith("registration.")}
    network.load_state_dict(other, strict=False)
    return network.eval()


def proposals(network: PoseNetwork, shards: Path) -> Proposals:
    dataset = ShardDataset(shards)
    depth = torch.from_numpy(dataset[0].depth)[None]
    with torch.no_grad():
        return network.propose(network.encode(depth, intrinsics_of(dataset.header.camera)[None]))[0]


def test_registration_hears_what_the_image_shows_within_each_hypothesiss_box(
    seeing: PoseNetwork, debug_shards: Path
) -> None:
    found = proposals(seeing, debug_shards)
    assert found.seen is not None and len(found.hypotheses) > 2
    assert found.seen.shape == (len(found.hypotheses), 9 * seeing.backbone.channels)
    scored, blind = seeing.score(found), seeing.score(found._replace(seen=torch.zeros_like(found.seen)))
    assert scored.registered is not None and blind.registered is not None
    assert (scored.registered - blind.registered).abs().max() > 1e-3
    assert torch.equal(scored.confidence, blind.confidence)


def test_an_image_in_which_nothing_is_found_is_scored_too(seeing: PoseNetwork, debug_shards: Path) -> None:
    found = proposals(seeing, debug_shards)
    assert found.seen is not None
    nothing = found.hypotheses.select(torch.zeros(0, dtype=torch.long))
    scored = seeing.score(found._replace(hypotheses=nothing, seen=found.seen[:0]))
    assert scored.registered is not None and len(scored.registered) == 0


def test_scores_may_learn_from_boxes_that_prediction_would_drop(seeing: PoseNetwork) -> None:
    own = seeing.detector.limits
    assert seeing.while_scoring_learns().detection is None
    seeing.config = with_options(seeing.config, "train", scoring_overlap=0.9)
    assert seeing.while_scoring_learns().detection == replace(own, nms_iou=0.9, least=2 * own.least)


def test_a_model_from_before_sees_nothing_and_the_papers_does() -> None:
    document = preset("small").to_json()
    del document["network"]["registration_cells"]
    assert type(preset("small")).from_json(document).network.registration_cells == 0
    assert preset("paper").network.registration_cells == 7
