"""The moving average follows its definition, stands in and steps back, and goes on from where it was."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from posenet.optimizers.ema import WeightAverage


def network(seed: int = 0) -> nn.Module:
    torch.manual_seed(seed)
    return nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4))


def wander(part: nn.Module, average: WeightAverage, steps: int, seed: int) -> list[torch.Tensor]:
    """Random weights, step by step; the first layer's at each."""
    generator = torch.Generator().manual_seed(seed)
    seen = []
    for _ in range(steps):
        for value in part.state_dict().values():
            value.copy_(torch.rand(value.shape, generator=generator) * 10)
        average.update(part)
        seen.append(part.state_dict()["0.weight"].clone())
    return seen


def test_it_is_the_weighted_mean_of_all_steps() -> None:
    part = network()
    expected = part.state_dict()["0.weight"].clone()
    average = WeightAverage(part, 0.5)
    for n, weight in enumerate(wander(part, average, 20, seed=1)):
        decay = min(0.5, (1 + n) / (10 + n))
        expected = decay * expected + (1 - decay) * weight
    torch.testing.assert_close(average.weights["0.weight"], expected)


def test_running_statistics_are_averaged_and_counters_are_taken_over() -> None:
    part = network()
    average = WeightAverage(part, 0.9)
    wander(part, average, 3, seed=2)
    state = part.state_dict()
    assert not torch.equal(average.weights["1.running_mean"], state["1.running_mean"])
    assert torch.equal(average.weights["1.num_batches_tracked"], state["1.num_batches_tracked"])


def test_it_stands_in_within_the_block_and_steps_back_after_an_error() -> None:
    part = network()
    average = WeightAverage(part, 0.9)
    wander(part, average, 3, seed=3)
    own = {name: value.clone() for name, value in part.state_dict().items()}
    with pytest.raises(KeyboardInterrupt), average.in_place_of(part):
        assert torch.equal(part.state_dict()["0.weight"], average.weights["0.weight"])
        raise KeyboardInterrupt
    assert all(torch.equal(own[name], value) for name, value in part.state_dict().items())


def test_restored_it_goes_on_bit_for_bit() -> None:
    part, other = network(), network(1)
    average = WeightAverage(part, 0.99)
    wander(part, average, 4, seed=4)
    restored = WeightAverage(other, 0.99)
    restored.restore(average.state())
    wander(part, average, 4, seed=5), wander(other, restored, 4, seed=5)
    assert all(torch.equal(average.weights[name], value) for name, value in restored.weights.items())
