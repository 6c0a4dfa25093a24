"""A model learns from what images verify, and from nothing else; it is replaced by a better one only."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.depth.sources import DepthSource, open_source
from evalkit.errors import InputError
from evalkit.evidence.ray_tracer import RayTracer
from evalkit.evidence.verdict import Verifier
from posenet.adaptation.adapt import adapt
from posenet.adaptation.labeled_batches import batch_of
from posenet.adaptation.labeled_image import LabeledImage
from posenet.adaptation.pseudo_labels import label
from posenet.adaptation.worth import Worth
from posenet.commands.cli import main
from posenet.models.model_file import load_model
from posenet.prediction.predictor import PredictedPoses, Predictor


class Knowing(Predictor):
    """A predictor that says what it is told; everything else is a real one's."""

    def __init__(self, run: Path, poses: np.ndarray, score: float = 0.9) -> None:
        super().__init__(load_model(run).network)
        self.poses, self.score = poses, score

    def predict_batch(self, *_: object, **__: object) -> list[PredictedPoses]:
        count = len(self.poses)
        boxes = np.tile([10.0, 10.0, 30.0, 30.0], (count, 1))
        return [PredictedPoses(self.poses, np.full(count, self.score), boxes, np.arange(count), 0.0)]


@pytest.fixture(scope="module")
def labeled(run_folder: Path, debug_shards: Path) -> tuple[LabeledImage, ShardDataset]:
    """The true poses of an image as labels, and one that the image contradicts."""
    dataset = ShardDataset(debug_shards)
    view = dataset[0]
    wrong = view.instances.cam_from_obj[:1].copy()
    wrong[:, 2, 3] -= 0.1
    poses = np.concatenate([view.instances.cam_from_obj, wrong])
    predictor = Knowing(run_folder, poses)
    return label(predictor, Verifier(predictor.model), view.depth, view.camera, "a"), dataset


def test_verified_poses_are_labels_and_others_are_left_out(labeled: tuple[LabeledImage, ShardDataset]) -> None:
    image, dataset = labeled
    truth = dataset[0].instances
    assert image.count >= (truth.visibility_returned >= 0.5).sum() > 0
    assert (image.visibility == 0).sum() >= 1  # the contradicted pose: neither part nor background
    sure = image.cam_from_obj[image.visibility > 0].double().numpy()
    nearest = np.abs(sure[:, None, :3, 3] - truth.cam_from_obj[None, :, :3, 3]).sum(-1).argmin(1)
    boxes = image.boxes[image.visibility > 0].numpy()
    scale = image.camera.width / dataset.header.camera.width
    assert np.median(np.abs(boxes - scale * truth.box_returned[nearest])) <= 2.0


def test_what_the_image_verifies_but_the_model_doubts_is_no_label(run_folder: Path, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    predictor = Knowing(run_folder, view.instances.cam_from_obj, score=0.3)
    verifier = Verifier(predictor.model)
    doubted = label(predictor, verifier, view.depth, view.camera, "a")
    assert doubted.count == 0 and len(doubted.visibility) > 0  # left out: neither part nor background
    predictor.score = 0.9
    sure = label(predictor, verifier, view.depth, view.camera, "a")
    predictor.score = 0.3
    assert label(predictor, verifier, view.depth, view.camera, "a", sure).count == sure.count > 0  # known from before


@pytest.mark.parametrize(("angle", "zoom"), [(math.pi, 1.0), (0.6, 1.0), (-2.0, 1.15), (0.0, 0.85)])
def test_a_turned_image_is_the_scene_of_a_turned_camera(
    labeled: tuple[LabeledImage, ShardDataset], angle: float, zoom: float
) -> None:
    image, dataset = labeled
    tracer, turned = RayTracer(dataset.header.object), image.turned(angle, zoom)
    row = int(turned.visibility.argmax())
    center = turned.cam_from_obj[row, :3, 3]
    before = int((image.cam_from_obj[:, :3, 3].norm(dim=1) - center.norm()).abs().argmin())
    shares = []
    for one, number in ((image, before), (turned, row)):
        traced = tracer.trace(one.cam_from_obj[number].double().numpy(), one.camera)
        seen = np.abs(one.depth.numpy()[traced.v, traced.u] - traced.depth) < 0.005
        box = one.boxes[number].numpy()
        inside = (traced.u + 1 >= box[0]) & (traced.u <= box[2]) & (traced.v + 1 >= box[1]) & (traced.v <= box[3])
        assert inside[seen].mean() > 0.95
        shares.append(seen.mean())
    assert shares[0] > 0.3 and shares[1] > shares[0] - 0.15  # the nearest pixel may lie beyond an edge


def test_a_turn_and_the_turn_back_give_the_labels_again(labeled: tuple[LabeledImage, ShardDataset]) -> None:
    image, _ = labeled
    again = image.turned(math.pi).turned(-math.pi)
    torch.testing.assert_close(again.boxes, image.boxes)
    torch.testing.assert_close(again.cam_from_obj, image.cam_from_obj)
    assert torch.equal(again.depth, image.depth)
    assert again.camera.cx == pytest.approx(image.camera.cx) and again.camera.fy == pytest.approx(image.camera.fy)


def test_what_the_frame_cuts_off_is_not_learned(labeled: tuple[LabeledImage, ShardDataset]) -> None:
    image, _ = labeled
    near = image.turned(0.3, 4.0)
    assert near.count < image.count
    assert (near.boxes[:, 2:] >= near.boxes[:, :2]).all() and near.boxes.min() >= 0.0


def test_batches_follow_from_seed_and_step(labeled: tuple[LabeledImage, ShardDataset], run_folder: Path) -> None:
    network = load_model(run_folder).network
    images = [labeled[0]] * 3
    first, again, other = (batch_of(images, network.config.train, 0.1, 0, step) for step in (0, 0, 1))
    torch.testing.assert_close(first.depth, again.depth)
    assert first.depth.shape != other.depth.shape or not torch.equal(first.depth, other.depth)
    losses = network.train()(first, 1)
    assert all(torch.isfinite(mean.value) for mean in losses.values())


def test_a_model_is_worth_what_is_verified_less_what_is_wrong() -> None:
    assert Worth(10, 0).f1(10) == 1.0
    assert Worth(10, 0).f1(20) == pytest.approx(20 / 30)
    assert Worth(8, 2).f1(8) < Worth(8, 0).f1(8)
    assert Worth(0, 0).f1(0) == 0.0


def test_what_cannot_be_adapted_is_refused_in_one_sentence(
    run_folder: Path, debug_shards: Path, tmp_path: Path
) -> None:
    runner = CliRunner()
    before = (run_folder / "model.pt").read_bytes()
    for model in (run_folder, run_folder / "model.pt"):
        done = runner.invoke(main, ["adapt", str(model), str(debug_shards), "-o", str(run_folder / "model.pt")])
        assert done.exit_code == 2 and "never overwritten" in done.output
    assert (run_folder / "model.pt").read_bytes() == before
    source = open_source(debug_shards)
    short = replace(source, names=source.names[:2], cameras=source.cameras[:2])
    with pytest.raises(InputError, match="at least 3"):
        adapt(run_folder, short, tmp_path / "new.pt")
    empty = DepthSource(source.path, source.names, source.cameras, lambda number: 0 * source.read(number))
    with pytest.raises(InputError, match="too few to learn from"):
        adapt(run_folder, empty, tmp_path / "new.pt", minutes=0.01)
    assert not (tmp_path / "new.pt").exists()
