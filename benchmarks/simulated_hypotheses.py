"""Hypotheses as a network may propose them, made from the truth: many right and wrong ones for any object, untrained.

Each instance that is seen at all has some detections, fewer the less is seen of it. A detection has two to five poses:
near the truth, turned by a half or a quarter about an axis of the object (near-symmetries), of a neighbor, or anything.
Other detections lie between instances. Scores know what is right more or less well, image by image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]
LEAST_SEEN, WELL_SEEN = 0.1, 0.6  # visibility: nothing is detected below, everything above
COPIES = 1.2  # more detections of an instance that is detected, on average
STRAY = 8.0  # detections of nothing, an image


class Hypotheses(NamedTuple):
    """n hypotheses of one image."""

    cam_from_obj: Array  # (n, 4, 4)
    score: Array  # (n,) in [0, 1]
    detection: NDArray[np.int64]  # (n,)


def simulated(
    rng: np.random.Generator,
    model: ObjectModel,
    truth: Array,  # (m, 4, 4)
    visibility: Array,  # (m,)
    foreign: bool = False,
) -> Hypotheses:
    """Hypotheses about instances; where they are `foreign`, of another object, none is near any of them."""
    proposer = _Proposer(rng, model, truth, foreign)
    for pose, seen in zip(truth, np.clip((visibility - LEAST_SEEN) / (WELL_SEEN - LEAST_SEEN), 0, 1), strict=True):
        detected = rng.random() < 0.35 + 0.65 * min(1.0, 2 * seen)
        for _ in range(int(detected) * (1 + rng.poisson(COPIES))):
            proposer.detect(pose, float(seen))
    for _ in range(rng.poisson(STRAY) if len(truth) > 1 else 0):
        proposer.stray()
    return proposer.hypotheses()


class _Proposer:
    """A network of some quality, whose scores are worth some trust."""

    def __init__(self, rng: np.random.Generator, model: ObjectModel, truth: Array, foreign: bool) -> None:
        self.rng, self.model, self.truth, self.foreign = rng, model, truth, foreign
        self.quality, self.trust = rng.uniform(0.15, 0.95), rng.uniform(0.3, 1.0)
        self.axes = np.linalg.eigh(model.lam_in_obj)[1].T
        self.found: list[tuple[Array, float, int]] = []
        self.detections = 0

    def hypotheses(self) -> Hypotheses:
        if not self.found:
            return Hypotheses(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.int64))
        cam_from_obj, score, detection = zip(*self.found, strict=True)
        return Hypotheses(np.stack(cam_from_obj), np.array(score), np.array(detection))

    def detect(self, pose: Array, seen: float) -> None:
        """Two to five hypotheses about an instance, one of them near it if all goes well."""
        rng, bad = self.rng, 1 - self.quality
        good = not self.foreign and rng.random() < 0.15 + 0.75 * self.quality * (0.35 + 0.65 * seen)
        count = int(rng.integers(2, 6))
        right = int(rng.integers(0, count)) if rng.random() > self.quality else 0
        if not good and rng.random() < 0.15:
            pose = self.truth[rng.integers(len(self.truth))]
        off = rng.gamma(2.0, 0.5) * (0.02 + 0.04 * bad + 0.05 * (1 - seen))
        for number in range(count):
            if good and number == right:
                degrees = min(rng.gamma(1.5, 4 + 16 * bad + 8 * (1 - seen)), 60.0)
                guess = self._near(pose, degrees, off, 0.02 + 0.04 * (1 - seen))
            else:
                guess = self._wrong(pose, off)
            known = self.trust * (2.0 if good and number == right else -1.8)
            noise = 1.5 * (1 - self.trust) * rng.standard_normal() + rng.standard_normal()
            self._add(guess, known + noise + seen - 0.5 - 0.3 * number)
        self.detections += 1

    def stray(self) -> None:
        """A detection between two instances."""
        some = self.truth[self.rng.integers(len(self.truth), size=2)]
        middle = self.model.centers(some).mean(0)
        for turn in poses.random_rotations(self.rng, int(self.rng.integers(1, 5))):
            self._add(self._centered(turn, middle), self.rng.standard_normal() - 2.0)
        self.detections += 1

    def _add(self, pose: Array, logit: float) -> None:
        self.found.append((pose, float(1 / (1 + np.exp(-logit))), self.detections))

    def _wrong(self, pose: Array, off: float) -> Array:
        kind = self.rng.random()
        if kind < 0.45:
            angle = self.rng.choice([np.pi, np.pi, np.pi / 2, -np.pi / 2])
            turn = pose[:3, :3] @ poses.from_axis_angle(self.axes[self.rng.integers(3)], angle)
            flipped = self._centered(turn, self.model.centers(pose[None])[0])
            return self._near(flipped, self.rng.gamma(1.5, 8.0), off, 0.04)
        if kind < 0.7:
            return self._near(pose, self.rng.uniform(25, 90), 1.5 * off, 0.06)
        center = self.model.centers(pose[None])[0] + 0.05 * self.model.diameter * self.rng.standard_normal(3)
        return self._centered(poses.random_rotations(self.rng, 1)[0], center)

    def _near(self, pose: Array, degrees: float, aside: float, along: float) -> Array:
        """A pose turned by so much, and shifted across and along the ray by so many diameters."""
        turn = poses.from_axis_angle(self.rng.standard_normal(3), np.radians(degrees)) @ pose[:3, :3]
        center = self.model.centers(pose[None])[0]
        ray = center / np.linalg.norm(center)
        across = self.rng.standard_normal(3)
        across -= (across @ ray) * ray
        shift = across * aside / np.sqrt(2) + ray * along * self.rng.standard_normal()
        return self._centered(turn, center + self.model.diameter * shift)

    def _centered(self, turn: Array, center: Array) -> Array:
        return poses.from_rotation_translation(turn, center - turn @ self.model.centroid)
