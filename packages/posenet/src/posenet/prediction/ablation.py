"""Parts of a trained network switched off for prediction, to measure what they bring."""

from __future__ import annotations

from dataclasses import dataclass

from posenet.config import with_options
from posenet.network.pose_network import PoseNetwork


@dataclass(frozen=True)
class Ablation:
    """What prediction goes without; the default is the network as trained."""

    registration: bool = True  # without: the score is the confidence
    offset: bool = True  # without: the centre of the region stands in for the projected centre
    hypotheses: int | None = None  # at most so many poses a detection

    def apply(self, network: PoseNetwork) -> PoseNetwork:
        """The same network without those parts; what it was trained without stays off."""
        network.config = with_options(
            network.config, "network",
            registration=False if not self.registration else None,
            offset=False if not self.offset else None,
            hypotheses=self.hypotheses,
        )  # fmt: skip
        if not self.registration:
            network.registration = None
        network.heads.config = network.config.network
        return network
