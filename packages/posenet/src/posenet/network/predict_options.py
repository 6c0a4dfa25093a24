"""What prediction may do otherwise than the network was trained to: parts switched off, other limits of detection."""

from __future__ import annotations

from dataclasses import dataclass

from posenet.detectors.base import DetectionLimits


@dataclass(frozen=True)
class PredictOptions:
    """The default is the network as trained; what it was trained without stays off."""

    registration: bool = True  # without: the score is the confidence
    offset: bool = True  # without: the center of the region stands in for the projected center
    hypotheses: int | None = None  # at most so many poses a detection
    detection: DetectionLimits | None = None  # None: the detector's own
