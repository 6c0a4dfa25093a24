"""One optimizer step: the losses of a batch that all ranks share, their gradients, and the weights after it."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import torch
from lightning_fabric import Fabric
from torch import Tensor

from posenet.config import Config
from posenet.layers.mean import Mean
from posenet.network import losses
from posenet.network.pose_network import PoseNetwork
from posenet.network.targets import Batch
from posenet.optimizers.ema import WeightAverage
from posenet.optimizers.make import build_optimizers
from posenet.optimizers.schedule import learning_rate_factor
from posenet.training.rank import Rank


class StepLosses(NamedTuple):
    """What a step measured, over the batch of all ranks."""

    parts: dict[str, Mean]  # unweighted, by name
    total: Tensor  # scalar, weighted


class NotFiniteError(Exception):
    """A loss or a gradient became NaN or infinite; the message names the parts."""


class Learner:
    """A network with its two optimizers (main and scoring) and, on the leading rank, the moving average of its weights.

    The parameters that score hypotheses learn on detached features, from `scoring_start` of the run on, on every
    `scoring_every`th step.
    """

    def __init__(self, network: PoseNetwork, config: Config, fabric: Fabric, rank: Rank) -> None:
        self.config, self.loss_config = config.train, config.loss
        self.fabric, self.rank = fabric, rank
        self.network = network.in_fast_layout()
        main, scoring = build_optimizers(network, self.config)
        self.module, self.main, *rest = fabric.setup(self.network, main, *([scoring] if scoring else []))
        self.scoring = rest[0] if rest else None
        self.average = WeightAverage(self.network, self.config.ema) if self.config.ema > 0 and rank.leads else None

    def take_step(self, batch: Batch, step: int, progress: float) -> StepLosses:
        """Move the weights along the gradient of this rank's share of a batch and of the other ranks' shares.

        Args:
            step: its number. progress: share of the run that is done, 0 to 1; the learning rate follows from it.

        Raises:
            NotFiniteError: before the weights have changed.
        """
        self._set_learning_rates(self.learning_rate_factor(progress))
        scores = progress >= self.config.scoring_start and step % self.config.scoring_every == 0
        self.network.train()
        found = self.module(batch, self._scoring_images if scores else 0)
        measured = self._measured(found)
        self.fabric.backward(self._to_minimize(found, measured.parts))
        for part in (self.network.main_parameters(), self.network.scoring_parameters()):
            norm = torch.nn.utils.clip_grad_norm_(list(part), self.config.clip_gradient)
            _require_finite({"gradient": norm})
        self.main.step()
        if self.scoring and scores:
            self.scoring.step()
        if self.average:
            self.average.update(self.network)
        return measured

    def learning_rate_factor(self, progress: float) -> float:
        """The share of the peak learning rate at `progress`."""
        return learning_rate_factor(progress, self.config.schedule, self.config.warmup, self.config.decay)

    def averaged(self) -> AbstractContextManager[None]:
        """Within the block the network has the weights to validate and keep: the moving average, where there is one."""
        return self.average.in_place_of(self.network) if self.average else nullcontext()

    def state(self) -> dict[str, Any]:
        """What a checkpoint holds of it."""
        return {
            "weights": self.network.state_dict(),
            "average": self.average.state() if self.average else None,
            "main": self.main.state_dict(),
            "scoring": self.scoring.state_dict() if self.scoring else None,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state`."""
        self.network.load_state_dict(state["weights"])
        self.main.load_state_dict(state["main"])
        if self.scoring and state["scoring"]:
            self.scoring.load_state_dict(state["scoring"])
        if self.average and state.get("average"):
            self.average.restore(state["average"])

    def _set_learning_rates(self, factor: float) -> None:
        for optimizer in [self.main] + ([self.scoring] if self.scoring else []):
            for group in optimizer.param_groups:
                group["lr"] = group["initial_lr"] * factor
            optimizer.zero_grad(set_to_none=True)

    def _measured(self, found: dict[str, Mean]) -> StepLosses:
        """The losses of all ranks from those that this one found."""
        parts = self.rank.summed(found)
        total = losses.total(parts, self.loss_config)
        if not torch.isfinite(total):
            _require_finite({name: mean.total for name, mean in parts.items()} | {"total": total})
        return StepLosses(parts, total)

    def _to_minimize(self, found: dict[str, Mean], of_all_ranks: dict[str, Mean]) -> Tensor:
        """This rank's loss, from its own sums and the counts of all."""
        if self.rank.size == 1:
            return losses.total(found, self.loss_config)
        # DDP takes the mean of all ranks' gradients, of what are addends here, and waits for every parameter's.
        addend = losses.total(found, self.loss_config, of_all_ranks)
        nothing = torch.stack([parameter.sum() for parameter in self.network.parameters()]).sum() * 0.0
        return addend * self.rank.size + nothing

    @property
    def _scoring_images(self) -> int:
        """How many of this rank's images train the scores: its share, but one at least, so that all take part."""
        return max(1, len(self.rank.share(range(self.config.scoring_images))))


def _require_finite(values: dict[str, Tensor]) -> None:
    bad = [name for name, value in values.items() if not torch.isfinite(value)]
    if bad:
        raise NotFiniteError(", ".join(bad))
