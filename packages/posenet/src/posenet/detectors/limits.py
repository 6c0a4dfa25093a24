"""The detector that a configuration names, with limits that follow from the object and the image."""

from __future__ import annotations

from dataclasses import replace

from evalkit.objects.model import ObjectModel, surface_moments
from posenet.config import NetworkConfig
from posenet.detectors.base import Detector
from posenet.detectors.heatmap import HEATMAP_LIMITS, HeatmapDetector
from posenet.detectors.rpn import RPN_LIMITS, RpnDetector

LEAST_SHOWN = 0.2  # of its silhouette, by an instance that is worth a detection


def build_detector(
    config: NetworkConfig, channels: int, stride: int, model: ObjectModel, object_size: float
) -> Detector:
    """A detector on features of so many channels at that stride, for objects `object_size` pixels across."""
    own = HEATMAP_LIMITS if config.detector == "heatmap" else RPN_LIMITS
    limits = replace(own, least=config.max_detections, density=greatest_density(model, object_size))
    if config.detector == "heatmap":
        return HeatmapDetector(channels, stride, object_size, limits=limits, norm=config.norm)
    # Anchors from the whole object to what is left of one seen end-on and half hidden.
    sizes = tuple(scale * object_size for scale in (0.4, 0.6, 0.85))
    return RpnDetector(
        channels,
        stride,
        sizes,
        fc_width=config.fc_width,
        dropout=config.dropout,
        roi_size=config.roi_size,
        limits=limits,
    )


def greatest_density(model: ObjectModel, object_size: float) -> float:
    """The most detections a pixel, where the diameter is `object_size` pixels.

    Each shows at least a share of the object's mean silhouette, which is a quarter of a convex body's surface (Cauchy).
    """
    surface = model.diameter**2
    if model.vertices is not None and model.faces is not None:
        surface = surface_moments(model.vertices, model.faces)[0]
    silhouette = surface / 4.0 * (object_size / model.diameter) ** 2
    return 1.0 / (LEAST_SHOWN * silhouette)
