"""An exponential moving average of a network's weights: often a little better than where the optimizer stands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class WeightAverage:
    """The average of all weights and running statistics of `network` after each step.

    The first steps count for more, as a plain mean would have it (decay (1 + n) / (10 + n) while that is less), so that
    the random start is soon forgotten.
    """

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.decay, self.updates = decay, 0
        self.weights = {name: value.detach().clone() for name, value in network.state_dict().items()}

    @torch.no_grad()
    def update(self, network: nn.Module) -> None:
        """Take in the weights after one more step."""
        decay = min(self.decay, (1 + self.updates) / (10 + self.updates))
        self.updates += 1
        for name, value in network.state_dict().items():
            if value.is_floating_point():
                self.weights[name].lerp_(value, 1.0 - decay)
            else:
                self.weights[name].copy_(value)

    @contextmanager
    def in_place_of(self, network: nn.Module) -> Iterator[None]:
        """The average in the network's place, within the `with` block."""
        own = {name: value.detach().clone() for name, value in network.state_dict().items()}
        network.load_state_dict(self.weights)
        try:
            yield
        finally:
            network.load_state_dict(own)

    def state(self) -> dict[str, int | dict[str, Tensor]]:
        """What a checkpoint holds of it."""
        return {"updates": self.updates, "weights": self.weights}

    def restore(self, state: dict[str, int | dict[str, Tensor]]) -> None:
        """Go on from :meth:`state`."""
        assert isinstance(state["updates"], int) and isinstance(state["weights"], dict)
        self.updates = state["updates"]
        for name, value in state["weights"].items():
            self.weights[name].copy_(value)
