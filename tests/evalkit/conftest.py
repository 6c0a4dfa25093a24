"""Objects of every symmetry class, and crowds of them with predictions of every quality."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from evalkit import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry

FINITE = ("none", "cyclic:2", "cyclic:5", "dihedral:3", "tetrahedral", "octahedral")
SYMMETRIES = (*FINITE, "revolution", "revolution-flip", "sphere")


def model_with(symmetry_name: str, seed: int = 0) -> ObjectModel:
    """An object 0.1 m across, off its frame's origin, whose surface moments obey its symmetry."""
    rng = np.random.default_rng(seed)
    frame = poses.random_rotations(rng, 1)[0]
    symmetry = Symmetry.parse(symmetry_name, frame)
    rough = rng.normal(size=(3, 3))
    covariance = rough @ rough.T * 2e-4 + np.eye(3) * 2e-4
    elements = symmetry.elements()
    covariance = (elements @ covariance @ np.swapaxes(elements, 1, 2)).mean(0)
    variances, axes = np.linalg.eigh(covariance)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    centroid = rng.normal(0, 0.01, 3)
    points = rng.normal(0, 0.02, (60, 3)) + centroid
    return ObjectModel(
        name=f"thing-{symmetry_name}",
        diameter=0.1,
        centroid=centroid,
        inertial_from_obj=poses.invert(poses.from_rotation_translation(axes, centroid)),
        lam=np.diag(np.sqrt(variances)),
        symmetry=symmetry,
        threshold=0.01,
        points=points,
    )


def equivalent_poses(model: ObjectModel, cam_from_obj: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Poses (n, 4, 4) that look the same: random symmetries about the centroid, any angle of the continuous ones."""
    symmetry, count = model.symmetry, len(cam_from_obj)
    if symmetry.kind == "sphere":
        turn = poses.random_rotations(rng, count)
    else:
        turn = symmetry.rotations[rng.integers(len(symmetry.rotations), size=count)]
    if symmetry.kind == "revolution":
        turn = turn @ poses.from_axis_angle(symmetry.axis, rng.uniform(0, 7, count))
    return cam_from_obj @ poses.from_rotation_translation(turn, model.centroid - turn @ model.centroid)


def random_crowd(model: ObjectModel, seed: int, images: int = 6) -> tuple[Predictions, GroundTruth]:
    """Crowded images and predictions: good, poor, far, exact copies, tied scores; some images without one or either."""
    rng = np.random.default_rng(seed)
    truths, predictions = [], []
    for number in range(images):
        count = int(rng.integers(0, 7))
        truth = _random_poses(rng, count)
        truths.append(GroundTruthImage(f"i{number}", None, truth, rng.choice([0.2, 0.5, 0.9], count)))
        near = truth[rng.integers(0, count, 2 * count)] if count else truth
        near = equivalent_poses(model, near, rng) @ _small_motions(rng, len(near))
        guesses = np.concatenate([near, near[: len(near) // 3], _random_poses(rng, int(rng.integers(0, 3)))])
        score = rng.integers(1, 8, len(guesses)) / 8
        if rng.random() < 0.25:
            guesses, score = guesses[:0], score[:0]
        if rng.random() < 0.85:
            predictions.append(PredictionImage(f"i{number}", guesses, score))
    if not predictions:
        predictions.append(PredictionImage("i0", np.zeros((0, 4, 4)), np.zeros(0)))
    return Predictions(model.name, predictions), GroundTruth(model, truths)


def _random_poses(rng: np.random.Generator, count: int) -> np.ndarray:
    """So much alike that neighbors compete for the same hypotheses."""
    turn = poses.from_axis_angle(rng.normal(size=(count, 3)), rng.exponential(0.25, count))
    return poses.from_rotation_translation(turn, rng.normal([0.0, 0.0, 0.5], 0.006, (count, 3)))


def _small_motions(rng: np.random.Generator, count: int) -> np.ndarray:
    turn = poses.from_axis_angle(rng.normal(size=(count, 3)), rng.exponential(0.2, count))
    return poses.from_rotation_translation(turn, rng.normal(0, 0.003, (count, 3)))


@pytest.fixture(params=SYMMETRIES)
def symmetric_model(request: pytest.FixtureRequest) -> ObjectModel:
    """One object of each symmetry class in turn."""
    return model_with(request.param)


@pytest.fixture
def plain_model() -> ObjectModel:
    """An object without symmetry."""
    return model_with("none")


@pytest.fixture
def make_crowd() -> Callable[..., tuple[Predictions, GroundTruth]]:
    return random_crowd


@pytest.fixture
def make_equivalent() -> Callable[..., np.ndarray]:
    return equivalent_poses
