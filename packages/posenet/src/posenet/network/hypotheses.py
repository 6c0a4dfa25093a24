"""Several poses a detection: the best few of each marginal, ranked by their product, thinned to distinct ones."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from posenet.coding import euler
from posenet.coding.pose_codec import PoseCodec
from posenet.coding.sym_distance import SymDistance
from posenet.network.pose_heads import PoseOutputs
from posenet.network.regions import Regions

MODES = (3, 2, 3)  # of a, b, c; and of depth:
DEPTH_MODES = 2
KEPT_PRODUCTS = 24  # the best products, before thinning: beyond them probability is negligible


class Hypotheses(NamedTuple):
    """H = n x k hypotheses of n detections, detection by detection, each detection's best first.

    Canonical object frame. `log_product` is the marginals' product; a regressed rotation counts the angle bins that it
    falls into.
    """

    detection: Tensor  # (H,) row of the detection
    rotation: Tensor  # (H, 3, 3)
    center: Tensor  # (H, 3) meters
    relative: Tensor  # (H, 3, 3) rotation in the ray frame
    offset: Tensor  # (H, 2)
    depth: Tensor  # (H,)
    log_product: Tensor  # (H,)

    def __len__(self) -> int:
        return len(self.detection)

    def select(self, rows: Tensor) -> Hypotheses:
        return Hypotheses(*(part[rows] for part in self))

    def numbered(self, detection: Tensor) -> Hypotheses:
        """The same with other numbers (H,) of their detections."""
        return Hypotheses(detection, *self[1:])

    @classmethod
    def joined(cls, parts: list[Hypotheses]) -> Hypotheses:
        """Several sets, one after the other; no two may number different detections alike."""
        return cls(*(torch.cat(part) for part in zip(*parts, strict=True)))


@torch.no_grad()
def generate(
    outputs: PoseOutputs, regions: Regions, codec: PoseCodec, distance: SymDistance, per_detection: int
) -> Hypotheses:
    """At most `per_detection` hypotheses for each of n regions, whose rows `detection` numbers.

    Greedy: a candidate nearer than the object's Sym threshold to a better one of the same detection is dropped.
    """
    found, kept = candidates(outputs, regions, codec, distance, per_detection)
    return found.select(kept.flatten())


def candidates(
    outputs: PoseOutputs, regions: Regions, codec: PoseCodec, distance: SymDistance, per_detection: int
) -> tuple[Hypotheses, Tensor]:
    """All that :func:`generate` chooses from, n * K rows, K for each region, best first, and which it keeps (n, K)."""
    relative, depth, mass = _products(outputs, codec)
    offset = outputs.offset[:, None].expand(*depth.shape, 2)
    windows, reference, intrinsics = regions.windows, regions.reference_depth, regions.intrinsics
    rotation, center = codec.decode(offset, depth, relative, windows[:, None], reference[:, None], intrinsics[:, None])
    kept = _thin(distance.pairwise(rotation, center), mass, codec.model.threshold, per_detection)
    detection = torch.arange(mass.shape[0], device=mass.device)[:, None].expand(mass.shape)
    parts = (detection, rotation, center, relative, offset, depth, mass)
    return Hypotheses(*(part.flatten(0, 1) for part in parts)), kept


def _products(outputs: PoseOutputs, codec: PoseCodec) -> tuple[Tensor, Tensor, Tensor]:
    """Rotations (n, K, 3, 3), depths (n, K) and log-products (n, K), best first."""
    interpolate = codec.config.interpolate
    logs = [logits.log_softmax(-1) for logits in outputs.angles]
    modes = [
        bins.peaks(log, k, interpolate and bins.count > 3)
        for bins, log, k in zip(codec.angle_bins, logs, MODES, strict=True)
    ]
    depth_log = outputs.depth.log_softmax(-1)
    depths, depth_mass = codec.depth_bins.peaks(depth_log, DEPTH_MODES, interpolate)
    (a, mass_a), (b, mass_b), (c, mass_c) = modes
    grid = torch.broadcast_tensors(a[:, :, None, None], b[:, None, :, None], c[:, None, None, :])
    mass_angles = (mass_a[:, :, None, None] + mass_b[:, None, :, None] + mass_c[:, None, None, :]).flatten(1)
    rotation = euler.from_angles(*(angle.flatten(1) for angle in grid))
    if codec.config.regress_rotation:
        rotation = torch.cat([outputs.rotation[:, None], rotation], 1)
        mass_angles = torch.cat([_regressed_mass(outputs.rotation, codec, logs)[:, None], mass_angles], 1)
    mass = (mass_angles[:, :, None] + depth_mass[:, None, :]).flatten(1)
    best, index = mass.topk(min(KEPT_PRODUCTS, mass.shape[1]), dim=1)
    turn, distance_mode = index // depths.shape[1], index % depths.shape[1]
    picked = rotation.gather(1, turn[..., None, None].expand(*turn.shape, 3, 3))
    return picked, depths.gather(1, distance_mode), best


def _regressed_mass(rotation: Tensor, codec: PoseCodec, logs: list[Tensor]) -> Tensor:
    """Log-product (n,) of the angle bins, with their neighbors, that regressed rotations (n, 3, 3) fall into."""
    angles = euler.to_angles(codec.canonical_label(rotation))
    total = torch.zeros(rotation.shape[0], device=rotation.device)
    for bins, log, angle in zip(codec.angle_bins, logs, angles, strict=True):
        if bins.count == 1:
            continue
        nearby = bins.labels(angle, 1.0)
        total = total + torch.logsumexp(log + (nearby * 3).clamp(max=1.0).log().clamp(min=-30.0), -1)
    return total


def _thin(distance: Tensor, mass: Tensor, threshold: float, most: int) -> Tensor:
    """Greedy suppression, best first: distances (n, K, K), log-masses (n, K) sorted -> kept (n, K) bool."""
    close, dropped = distance < threshold, mass == -math.inf
    count = torch.zeros_like(mass[:, 0], dtype=torch.long)
    kept = []
    for i in range(mass.shape[1]):
        keep = ~dropped[:, i] & (count < most)
        dropped = dropped | (close[:, :, i] & keep[:, None])
        count = count + keep
        kept.append(keep)
    return torch.stack(kept, 1)
