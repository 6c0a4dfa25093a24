"""The paper's losses: L = detection + offset + depth + rotation; registration has its own (network/registration).

The paper prints its cross-entropy without the minus sign; it is meant, and here.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from posenet.coding.pose_codec import PoseCodec, PoseLabels
from posenet.coding.sym_distance import SymDistance
from posenet.config import TASKS, LossConfig
from posenet.layers.mean import Mean
from posenet.network.pose_heads import PoseOutputs

LEAST_ANGLE_WEIGHT = 0.15


def pose_losses(
    outputs: PoseOutputs, labels: PoseLabels, codec: PoseCodec, distance: SymDistance, config: LossConfig
) -> dict[str, Mean]:
    """Unweighted losses of n regions; of none too, with a gradient of zero."""
    depth_labels = codec.depth_bins.labels(labels.depth, config.depth_sigma)
    losses = {"depth": Mean.of(cross_entropy(outputs.depth, depth_labels))}
    if codec.config.offset:
        losses["offset"] = offset_loss(outputs.offset, labels.offset, config.offset_norm)
    # a and c mean little where the object's z lies along the ray: only their sum (or difference) does.
    sine = labels.angles[:, 1].sin().clamp(min=LEAST_ANGLE_WEIGHT)
    for name, logits, bins, angle in zip(
        "abc", outputs.angles, codec.angle_bins, labels.angles.unbind(-1), strict=True
    ):
        if bins.count > 1:
            loss = cross_entropy(logits, bins.labels(angle, config.angle_sigma))
            losses[f"angle_{name}"] = Mean.of(loss if name == "b" else loss * sine)
    if codec.config.regress_rotation and codec.estimates_tilt:
        squared = distance.rotation_squared(outputs.rotation, labels.rotation)
        losses["rotation"] = Mean.of((squared + 1e-8).sqrt() / codec.model.threshold)
    return losses


def cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    """Of logits (n, c) against target distributions (n, c) -> (n,)."""
    return -(target * logits.log_softmax(-1)).sum(-1)


def offset_loss(predicted: Tensor, target: Tensor, norm: str) -> Mean:
    """L1 as the paper has it, or smooth L1 that is quadratic below a tenth of the region's side."""
    if norm == "l1":
        return Mean.of(F.l1_loss(predicted, target, reduction="none"))
    return Mean.of(F.smooth_l1_loss(predicted, target, beta=0.1, reduction="none"))


def weight_of(name: str, config: LossConfig) -> float:
    """The weight of a loss by its name; the parts of one task share that of the task, 0 where the task is off."""
    task = name.split("_")[0]
    head = "rotation" if task == "angle" else task
    if head in TASKS and head not in config.tasks:
        return 0.0
    return {
        "offset": config.offset,
        "depth": config.depth,
        "angle": config.angles,
        "rotation": config.rotation,
        "confidence": config.scoring,
        "registration": config.scoring,
    }.get(task, config.detection)


def total(losses: dict[str, Mean], config: LossConfig, counts: dict[str, Mean] | None = None) -> Tensor:
    """The weighted sum of all losses; with `counts` of several processes, this one's addend to the sum of them all."""
    means = {name: (loss if counts is None else Mean(loss.total, counts[name].over)) for name, loss in losses.items()}
    return torch.stack([weight_of(name, config) * mean.value for name, mean in means.items()]).sum()
