"""`posenet adapt`: rounds of labeling images by verified poses and learning from them; the better model is kept.

Self-training (Lee 2013) with labels that the images themselves vouch for: the network's poses are refined, the part is
ray traced at each, and what depth contradicts or cannot decide is no label. Network and labels improve by turns.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from evalkit.depth.sources import DepthSource
from evalkit.errors import InputError
from evalkit.evidence.verdict import Verifier
from posenet.adaptation.labeled_batches import batch_of
from posenet.adaptation.labeled_image import LabeledImage
from posenet.adaptation.pseudo_labels import label
from posenet.adaptation.worth import Worth, worth_of
from posenet.config import Config
from posenet.device import choose_device, supports_bf16
from posenet.models.model_file import MODEL_FILE, load_model, save_model
from posenet.network.pose_network import PoseNetwork
from posenet.optimizers.schedule import Budget
from posenet.prediction.predictor import Predictor
from posenet.training.learner import Learner, NotFiniteError
from posenet.training.rank import ALONE

log = logging.getLogger(__name__)

FEWEST_FRAMES = 3
HELD_OUT_EVERY = 4  # frames; the fourth of each is held out
ROUNDS = 2
RATE = 0.2  # of the learning rate that trained the network from nothing
FEWEST_LABELS = 5

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Adapted:
    """How an adaptation went, on held-out frames by image evidence."""

    before: Worth
    after: Worth
    parts: int  # known to be on the held-out frames
    labels: list[int]  # of each round
    frames: int
    held_out: int
    better: bool


def adapt(
    model: Path,
    source: DepthSource,
    out: Path,
    minutes: float = 5.0,
    device: str = "auto",
    seed: int = 0,
    progress: Progress = lambda *_: None,
) -> Adapted:
    """Let a model learn from a source's images, `minutes` of training, and write the better of old and new to `out`.

    Raises:
        InputError: the model or an image cannot be used, `out` is the model, there are too few images, or too few
            poses are verified to learn from.
    """
    require_other_file(model, out)
    if len(source.names) < FEWEST_FRAMES:
        raise InputError(
            f"{source.path}: {len(source.names)} image(s), and at least {FEWEST_FRAMES} are needed to learn from some "
            "and try others; take more."
        )
    trained = load_model(model, choose_device(device))
    held_out = list(range(HELD_OUT_EVERY - 1, len(source.names), HELD_OUT_EVERY)) or [len(source.names) - 1]
    learned_from = [number for number in range(len(source.names)) if number not in held_out]
    adaptation = _Adaptation(trained.network, source, seed, progress)
    before, known = adaptation.worth(held_out, False), adaptation.worth(held_out, True).verified
    labels = adaptation.learn(learned_from, minutes)
    after, parts = adaptation.worth(held_out, False), max(known, adaptation.worth(held_out, True).verified)
    better = after.f1(parts) > before.f1(parts)
    if not better:
        adaptation.restore()
    found = Adapted(before, after, parts, labels, len(learned_from), len(held_out), better)
    save_model(out, trained.network, {**trained.record, "adapted": _record(found, minutes, source)})
    return found


def require_other_file(model: Path, out: Path) -> None:
    """Raises: InputError: `out` is the model that is read, or a folder."""
    file = model / MODEL_FILE if model.is_dir() else model
    if out.exists() and file.exists() and out.samefile(file):
        raise InputError(f"{out}: is the model to adapt, which is never overwritten; choose another file with -o.")
    if out.is_dir():
        raise InputError(f"{out}: is a folder; name the file to write with -o, such as {out / 'adapted.pt'}.")


class _Adaptation:
    """A network on its way, and the images that it learns from."""

    def __init__(self, network: PoseNetwork, source: DepthSource, seed: int, progress: Progress) -> None:
        self.network, self.source, self.seed, self.progress = network, source, seed, progress
        self.verifier = Verifier(network.model)
        self._original = copy.deepcopy(network.state_dict())
        self._device = next(network.parameters()).device

    def restore(self) -> None:
        self.network.load_state_dict(self._original)

    def worth(self, numbers: list[int], refine: bool) -> Worth:
        self.progress("trying held-out frames", 0.0)
        return worth_of(Predictor(self.network, refine=refine), self.verifier, self.source, numbers)

    def learn(self, numbers: list[int], minutes: float) -> list[int]:
        """Rounds of labeling and training; how many labels each had."""
        config = _gentle(self.network.config)
        self.network.bf16 = supports_bf16(self._device)
        learner = Learner(self.network, config, ALONE.fabric(self._device, None), ALONE)
        labels, step, spent = [], 0, 0.0
        known: dict[int, LabeledImage] = {}
        for turn in range(ROUNDS):
            known = self._labeled(numbers, turn, known)
            images = [image for image in known.values() if image.count]
            labels.append(sum(image.count for image in images))
            budget = Budget(minutes=minutes, spent_before=spent)
            while (done := budget.progress(step)) < (turn + 1) / ROUNDS:
                self.progress("learning", done)
                batch = batch_of(images, config.train, self.network.model.diameter, self.seed, step)
                torch.manual_seed(self.seed + step)  # dropout draws globally
                try:
                    learner.take_step(batch.to(self._device), step, done)
                except NotFiniteError as parts:
                    raise InputError(
                        f"{self.source.path}: the loss became NaN (in: {parts}) on these images."
                    ) from None
                step += 1
            spent = budget.seconds  # labeling does not count
        self.network.eval()
        return labels

    def _labeled(self, numbers: list[int], turn: int, before: dict[int, LabeledImage]) -> dict[int, LabeledImage]:
        """Labels of the images, by number; what was verified `before` stays."""
        predictor, source, images = Predictor(self.network, refine=True), self.source, {}
        for count, number in enumerate(numbers):
            self.progress(f"labeling, round {turn + 1} of {ROUNDS}", count / len(numbers))
            seen = source.depth(number), source.cameras[number], source.names[number]
            images[number] = label(predictor, self.verifier, *seen, before.get(number))
        total = sum(image.count for image in images.values())
        log.info("Round %d: %d verified poses on %d images.", turn + 1, total, len(numbers))
        if total < FEWEST_LABELS:
            raise InputError(
                f"{source.path}: {total} poses of the model are verified by these images, too few to learn from; "
                "'posenet check' says why."
            )
        return images


def _gentle(config: Config) -> Config:
    """The training configuration with smaller steps, which begins where training ended."""
    train = replace(
        config.train, learning_rate=RATE * config.train.learning_rate, schedule="trapezoid", warmup=0.1, decay=0.6,
        scoring_start=0.0, ema=0.0,
    )  # fmt: skip
    return replace(config, train=train)


def _record(found: Adapted, minutes: float, source: DepthSource) -> dict[str, Any]:
    """What the model file says of it."""
    return {
        "minutes": minutes,
        "images": found.frames,
        "source": source.path.name,
        "labels": found.labels,
        "held_out": found.held_out,
        "f1_before": round(found.before.f1(found.parts), 4),
        "f1_after": round(found.after.f1(found.parts), 4),
        "kept": "new" if found.better else "old",
    }
