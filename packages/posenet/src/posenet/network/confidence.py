"""How likely a hypothesis is right, learned from the network's own hits and misses."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from posenet.network.hypotheses import Hypotheses

POSE_FEATURES = 9 + 2 + 1 + 2


class ConfidenceHead(nn.Module):
    """One logit a hypothesis, from the (detached) features of its region and the pose that it claims."""

    def __init__(self, feature_width: int, hidden: int = 128) -> None:
        super().__init__()
        self.features = nn.Linear(feature_width, hidden)
        self.pose = nn.Linear(POSE_FEATURES, hidden)
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, features: Tensor, detection_score: Tensor, hypotheses: Hypotheses, diameter: float) -> Tensor:
        """features (n, fc) and detection_score (n,) of n detections; H hypotheses -> logits (H,)."""
        row = hypotheses.detection
        pose = torch.cat(
            [
                hypotheses.relative.flatten(1),
                hypotheses.offset,
                (hypotheses.depth / diameter)[:, None],
                hypotheses.log_product.clamp(min=-20.0)[:, None],
                detection_score[row].clamp(1e-4, 1 - 1e-4).logit()[:, None],
            ],
            1,
        )
        return self.out(self.features(features.float())[row] + self.pose(pose))[:, 0]
