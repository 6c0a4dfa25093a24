"""What steps along the gradients: one optimizer for the multi-task network, one for what learns on its features."""

from __future__ import annotations

import torch
from torch.nn import Parameter
from torch.optim import Optimizer

from posenet.config import TrainConfig
from posenet.network.pose_network import PoseNetwork
from posenet.optimizers.muon import Muon


def build_optimizers(network: PoseNetwork, config: TrainConfig) -> tuple[Optimizer, Optimizer | None]:
    """Of the network, and of confidence and registration where it has any.

    The latter are small, see few hypotheses and have steps of their own size, which were found with AdamW.
    """
    precision = torch.bfloat16 if network.bf16 else torch.float32
    scoring = list(network.scoring_parameters())
    main = _optimizer(config.optimizer, list(network.main_parameters()), config.learning_rate, config, precision)
    if not scoring:
        return main, None
    name = "adam" if config.optimizer == "adam" else "adamw"
    return main, _optimizer(name, scoring, config.learning_rate * config.scoring_rate, config, precision)


def _optimizer(
    name: str, parameters: list[Parameter], rate: float, config: TrainConfig, precision: torch.dtype
) -> Optimizer:
    group = {"params": parameters, "initial_lr": rate}
    if name == "muon":
        return Muon([group], lr=rate, weight_decay=config.weight_decay, precision=precision)
    kind = torch.optim.Adam if name == "adam" else torch.optim.AdamW
    return kind([group], lr=rate, weight_decay=config.weight_decay, fused=True)
