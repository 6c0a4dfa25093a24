"""The network that predicts is a twin of the one that was trained: other layers, the same poses."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn

from evalkit.datasets.shard_folder import ShardDataset
from posenet.models.model_file import load_model
from posenet.network.depth_input import intrinsics_of
from posenet.network.pose_network import PoseNetwork
from posenet.prediction.fast_network import HalvingMax, _fewer, fast_network


@pytest.fixture(scope="module")
def network(run_folder: Path) -> PoseNetwork:
    return load_model(run_folder).network


def test_it_predicts_what_the_plain_network_does(network: PoseNetwork, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    images = torch.from_numpy(view.depth)[None], intrinsics_of(view.camera)[None]
    (plain,) = network.predict(*images)
    (fast,) = fast_network(network, bf16=False).predict(*images)
    assert len(plain.score) > 10
    for wanted, found in zip(plain, fast, strict=True):
        torch.testing.assert_close(found, wanted, rtol=0, atol=1e-4)


@pytest.mark.parametrize("bf16", [False, True])
def test_the_network_stays_as_it_was(network: PoseNetwork, bf16: bool) -> None:
    before = {name: value.clone() for name, value in network.state_dict().items()}
    network.train()
    twin = fast_network(network, bf16)
    assert network.training and all(module.training for module in network.modules())
    assert not twin.training and not any(isinstance(module, nn.BatchNorm2d) for module in twin.modules())
    assert any(isinstance(module, nn.BatchNorm2d) for module in network.modules())
    for name, value in network.state_dict().items():
        assert value.dtype == before[name].dtype and torch.equal(value, before[name])
    network.eval()


@pytest.mark.parametrize("seed", range(8))
def test_fewer_layers_compute_the_same(seed: int) -> None:
    torch.manual_seed(seed)
    layers: list[nn.Module] = []
    for draw in torch.randint(7, (9,)).tolist():
        layers += [
            [nn.Conv2d(4, 4, 3, padding=1)],
            [nn.Conv2d(4, 4, 3, padding=1, bias=False), nn.BatchNorm2d(4)],
            [nn.BatchNorm2d(4)],
            [nn.ReLU()],
            [nn.ReLU(), nn.MaxPool2d(2)],
            [nn.MaxPool2d(3, 1)],
            [nn.Dropout(0.5), nn.GroupNorm(2, 4)],
        ][draw]
    plain = nn.Sequential(*layers)
    values = torch.randn(8, 4, 64, 64)
    with torch.no_grad():
        plain(values)  # batch normalization gets statistics of its own
        plain.eval()
        kept = values.clone()
        wanted = plain(values)
        torch.testing.assert_close(nn.Sequential(*_fewer(layers)).eval()(values), wanted, rtol=1e-4, atol=1e-4)
    assert torch.equal(values, kept)


@pytest.mark.parametrize("shape", [(2, 3, 8, 6), (2, 3, 7, 5), (1, 1, 2, 2)])
def test_the_largest_of_four_is_that_of_pooling(shape: tuple[int, ...]) -> None:
    values = torch.randn(shape).contiguous(memory_format=torch.channels_last)
    assert torch.equal(HalvingMax()(values), nn.functional.max_pool2d(values, 2))
