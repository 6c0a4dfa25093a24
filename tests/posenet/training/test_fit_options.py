"""The ablations and options of `posenet fit` work end to end; shards that cannot train are refused in one sentence."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from evalkit.datasets.shard_folder import list_shards
from evalkit.datasets.shard_format import USER_BLOCK
from evalkit.datasets.shard_reader import ShardReader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.errors import InputError
from posenet.config import TASKS, Config, preset, with_options
from posenet.layers.mean import Mean
from posenet.network import backbone, losses
from posenet.network.pose_network import PoseNetwork
from posenet.prediction.predictor import Predictor
from posenet.training import trainer
from posenet.training.dataset import Frames
from posenet.training.fit_options import FitOptions
from posenet.training.train import fit


def options(shards: Path, out: Path, config: Config | None = None, **rest: object) -> FitOptions:
    chosen = {"epochs": 1, "device": "cpu", "validate": False} | rest
    return FitOptions([shards], out, config or preset("debug"), **chosen)  # type: ignore[arg-type]


ABLATIONS = [
    ("network", {"offset": False}),
    ("network", {"registration": False}),
    ("network", {"hypotheses": 1}),
    ("network", {"orientation": "egocentric"}),
    ("network", {"norm": "group"}),
    ("loss", {"registration_weights": "paper"}),
    ("loss", {"registration_weights": "balanced"}),
    ("loss", {"tasks": ("depth",)}),
    ("train", {"schedule": "cosine"}),
    ("train", {"schedule": "constant"}),
    ("train", {"optimizer": "adamw"}),
    ("network", {"crop_widths": (8, 16), "crop_layers": 2}),
]


@pytest.mark.parametrize(("section", "changes"), ABLATIONS, ids=lambda value: str(value))
def test_every_ablation_trains_and_predicts(
    debug_shards: Path, tmp_path: Path, section: str, changes: dict[str, object]
) -> None:
    config = with_options(with_options(preset("debug"), "train", scoring_start=0.0), section, **changes)
    run = fit(options(debug_shards, tmp_path / "run", config))
    predictor = Predictor.load(run.path, "cpu")
    assert getattr(getattr(predictor.network.config, section), next(iter(changes))) == next(iter(changes.values()))
    view = Frames(debug_shards).dataset[0]
    found = predictor.predict(view.depth, view.camera)
    assert np.isfinite(found.cam_from_obj).all() and np.isfinite(found.score).all()
    if changes == {"hypotheses": 1}:
        assert len(np.unique(found.boxes, axis=0)) == len(found.boxes)
    assert (predictor.network.registration is None) == (changes == {"registration": False})


@pytest.mark.parametrize("task", TASKS)
def test_a_head_trained_alone_is_the_only_one_with_a_gradient(debug_shards: Path, task: str) -> None:
    config = with_options(preset("debug"), "loss", tasks=(task,))
    torch.manual_seed(0)
    frames = Frames(debug_shards)
    network = PoseNetwork(config, frames.model, (0.3, 0.6), frames.camera)
    losses.total(network(frames.batch(np.arange(2))), config.loss).backward()
    heads = network.heads
    parts = {"offset": [heads.offset], "depth": [heads.depth], "rotation": [*heads.angles, heads.rotation]}
    for name, modules in parts.items():
        learns = [bool(p.grad is not None and p.grad.abs().sum() > 0) for m in modules for p in m.parameters()]
        assert all(learns) if name == task else not any(learns), name


def test_an_unknown_task_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="'shape' is none of offset, depth, rotation"):
        with_options(preset("debug"), "loss", tasks=("depth", "shape"))


@pytest.fixture(scope="module")
def imagenet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of VGG16's shape with random weights, and a classifier's beside."""
    torch.manual_seed(5)
    file = tmp_path_factory.mktemp("weights") / "vgg16.pth"
    torch.save({**backbone.vgg16(3).state_dict(), "classifier.0.bias": torch.zeros(2)}, file)
    return file


@pytest.fixture
def first_weights(monkeypatch: pytest.MonkeyPatch) -> list[torch.Tensor]:
    """The first layer of every network as it begins to train; no step is taken."""
    seen: list[torch.Tensor] = []

    def note(self: trainer.Trainer) -> None:
        seen.append(self.network.backbone.features[0].weight.detach().clone())

    monkeypatch.setattr(trainer.Trainer, "train", note)
    return seen


def thin_paper() -> Config:
    config = preset("paper")
    return with_options(config, "network", fc_width=16, registration_blocks=1)


def test_training_begins_at_the_weights_of_the_file(
    debug_shards: Path, tmp_path: Path, imagenet: Path, first_weights: list[torch.Tensor]
) -> None:
    fit(options(debug_shards, tmp_path / "with", thin_paper(), backbone_weights=imagenet))
    fit(options(debug_shards, tmp_path / "without", thin_paper()))
    wanted = torch.load(imagenet, weights_only=True)["features.0.weight"]
    assert torch.equal(first_weights[0], wanted) and not torch.equal(first_weights[1], wanted)
    with pytest.raises(InputError, match="differs in backbone_weights"):
        fit(options(debug_shards, tmp_path / "with", thin_paper()))


@pytest.mark.parametrize(
    ("preset_name", "kind", "says"),
    [("paper", "absent", "no such file"), ("paper", "text", "not a file of weights"), ("debug", "fits", "vgg_debug")],
)
def test_weights_that_do_not_fit_are_refused_and_the_folder_stays_free(
    debug_shards: Path, tmp_path: Path, imagenet: Path, preset_name: str, kind: str, says: str
) -> None:
    file = imagenet if kind == "fits" else tmp_path / "weights.pth"
    if kind == "text":
        file.write_text("no weights")
    config = thin_paper() if preset_name == "paper" else preset("debug")
    with pytest.raises(InputError, match=says) as caught:
        fit(options(debug_shards, tmp_path / "run", config, backbone_weights=file))
    assert str(file) in str(caught.value) and not (tmp_path / "run").exists()


Spoil = Callable[[Path], str]


def flip_a_byte(folder: Path) -> str:
    path = list_shards(folder)[0]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    return rf"{path.name}: its bytes do not match its checksum"


def truncate(folder: Path) -> str:
    path = list_shards(folder)[0]
    path.write_bytes(path.read_bytes()[: USER_BLOCK // 2])
    return path.name


def remove_all(folder: Path) -> str:
    for path in folder.iterdir():
        path.unlink()
    return "holds no shards"


def remove_one(folder: Path) -> str:
    list_shards(folder)[0].unlink()
    return "missing"


def another_schema(folder: Path) -> str:
    path = list_shards(folder)[0]
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = "binpose-shard/9"
    content = path.read_bytes()
    head = f"binpose-shard/9 sha256 {hashlib.sha256(content[USER_BLOCK:]).hexdigest()}\n".encode()
    path.write_bytes(head.ljust(USER_BLOCK, b"\0") + content[USER_BLOCK:])
    return rf"{path.name}: schema 'binpose-shard/9'"


def another_object(folder: Path) -> str:
    first = list_shards(folder)[0]
    with ShardReader(first) as reader:
        views, header = list(reader), reader.header
    (folder / "dataset.json").unlink()
    other = folder / "shard-00099.h5"
    header = replace(header, object=replace(header.object, name="brick"))
    with ShardWriter(other, header, len(views)) as writer:
        for view in views:
            writer.append(view)
    return rf"{other.name}: its object, camera or depth unit differs"


@pytest.mark.parametrize("spoil", [flip_a_byte, truncate, remove_all, remove_one, another_schema, another_object])
def test_shards_that_cannot_train_are_refused_in_one_sentence(debug_shards: Path, tmp_path: Path, spoil: Spoil) -> None:
    folder = tmp_path / "shards"
    shutil.copytree(debug_shards, folder)
    says = spoil(folder)
    with pytest.raises(InputError, match=says) as caught:
        fit(options(folder, tmp_path / "run"))
    assert "\n" not in str(caught.value) and not (tmp_path / "run").exists()


def test_a_gradient_that_is_not_finite_stops_before_it_spoils_the_weights(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = losses.total

    def finite_with_an_infinite_slope(found: dict[str, Mean], config: object) -> torch.Tensor:
        value = real(found, config)  # type: ignore[arg-type]
        return value + (value - value.detach()).abs().sqrt()

    monkeypatch.setattr(losses, "total", finite_with_an_infinite_slope)
    with pytest.raises(InputError, match=r"NaN at step 0 \(in: gradient\)"):
        fit(options(debug_shards, tmp_path / "run"))
