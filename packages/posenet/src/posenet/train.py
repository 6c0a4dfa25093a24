"""`posenet fit`: trains a network on shards, within a budget, resumably."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning_fabric import Fabric
from lightning_fabric.loggers import TensorBoardLogger
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from evalkit.errors import InputError
from posenet import losses
from posenet.config import Config
from posenet.dataset import Frames, Split, epoch_order
from posenet.device import choose_device, supports_bf16
from posenet.model_file import save_model
from posenet.network import PoseNetwork
from posenet.run_folder import RunFolder, data_hash, software_versions
from posenet.schedule import Budget, learning_rate_factor
from posenet.validation import validate

CHECKPOINT_SECONDS = 60.0
LOG_EVERY = 20


@dataclass(frozen=True)
class FitOptions:
    """What to train on, how long, and where to put it."""

    shards: list[Path]
    out: Path
    config: Config
    minutes: float | None = None
    epochs: int | None = None
    device: str = "auto"
    seed: int = 0
    validate: bool = True


def fit(options: FitOptions) -> RunFolder:
    """Train, or go on training; returns the run's folder, with the best model in it.

    Raises:
        InputError: the shards, the options or the folder cannot be used, or the loss became NaN.
    """
    choose_device(options.device)
    frames = Frames(list(options.shards))
    config = options.config
    share = config.train.validation_share if options.validate else 0.0
    split = frames.split(share, options.seed, config.train.validation_images)
    run = RunFolder(options.out)
    resuming = run.claim(_identity(options, frames))
    torch.manual_seed(options.seed)
    depth_range = frames.depth_range(split.train, config.train.min_visibility)
    network = PoseNetwork(config, frames.model, depth_range, frames.camera)
    trainer = Trainer(network, frames, split, run, options)
    if resuming:
        trainer.restore(run.load_checkpoint())
    trainer.train()
    return run


def _identity(options: FitOptions, frames: Frames) -> dict[str, Any]:
    return {
        "config": options.config.to_json(),
        "seed": options.seed,
        "minutes": options.minutes,
        "epochs": options.epochs,
        "validate": options.validate,
        "data": {"shards": [str(path) for path in options.shards], "sha256": data_hash(frames.dataset)},
        "software": software_versions(),
    }


class Trainer:
    """The loop: batches in a reproducible order, two optimisers, checkpoints, validation, the best model."""

    def __init__(self, network: PoseNetwork, frames: Frames, split: Split, run: RunFolder, options: FitOptions) -> None:
        self.options, self.config = options, options.config.train
        self.frames, self.split, self.run = frames, split, run
        device = choose_device(options.device)
        network.bf16 = self.config.precision == "bf16" or (self.config.precision == "auto" and supports_bf16(device))
        self.logger = TensorBoardLogger(run.path, name="", version="")
        self.fabric = Fabric(accelerator=device.type, devices=1, loggers=self.logger)
        self.network = network.in_fast_layout()
        main, scoring = _optimizers(network, options.config)
        self.module, self.main, *rest = self.fabric.setup(self.network, main, *([scoring] if scoring else []))
        self.scoring = rest[0] if rest else None
        self.step, self.images, self.best_ap, self.finished = 0, 0, -1.0, False
        self.validations: list[dict[str, float]] = []
        self.budget = self._budget()
        self.meter = _LossMeter()

    def train(self) -> None:
        """Run to the end of the budget; a finished run trains no more."""
        if self.finished:
            return
        bar = tqdm(total=100.0, desc="fit", bar_format=_BAR, initial=0.0, mininterval=0.5)
        saved = time.monotonic()
        try:
            for batch_frames in self._batches():
                progress = self.budget.progress(self.step)
                if progress >= 1.0:
                    break
                self._step(batch_frames, progress)
                bar.n = 100.0 * self.budget.progress(self.step)
                bar.set_postfix_str(self._status(), refresh=False)
                bar.update(0)
                if self._validation_due():
                    self._validate(bar)
                    self.save()
                if time.monotonic() - saved > CHECKPOINT_SECONDS:
                    self.save()
                    saved = time.monotonic()
        except KeyboardInterrupt:
            self.save()
            raise
        finally:
            bar.close()
        self._finish()

    def save(self) -> None:
        """Write the checkpoint: all that the next step depends on."""
        self.run.save_checkpoint(
            {
                "step": self.step,
                "images": self.images,
                "seconds": self.budget.seconds,
                "best_ap": self.best_ap,
                "validations": self.validations,
                "finished": self.finished,
                "weights": self.network.state_dict(),
                "main": self.main.state_dict(),
                "scoring": self.scoring.state_dict() if self.scoring else None,
                "random": torch.get_rng_state(),
            }
        )

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.network.load_state_dict(state["weights"])
        self.main.load_state_dict(state["main"])
        if self.scoring and state["scoring"]:
            self.scoring.load_state_dict(state["scoring"])
        torch.set_rng_state(state["random"])
        self.step, self.images, self.best_ap = state["step"], state["images"], state["best_ap"]
        self.validations, self.finished = state["validations"], state["finished"]
        self.budget.spent_before = state["seconds"]

    def _budget(self) -> Budget:
        if self.options.minutes is not None:
            return Budget(minutes=self.options.minutes)
        epochs = self.options.epochs or self.config.epochs
        return Budget(steps=epochs * self._steps_per_epoch)

    @property
    def _steps_per_epoch(self) -> int:
        return max(1, len(self.split.train) // self.config.batch_images)

    def _batches(self) -> Iterator[NDArray[np.int64]]:
        """Frame numbers of each further batch, for ever; epochs that a resumed run has seen are skipped."""
        size = min(self.config.batch_images, len(self.split.train))
        while True:
            epoch, position = divmod(self.step, self._steps_per_epoch)
            order = epoch_order(self.split.train, self.options.seed, epoch)
            yield order[position * size : (position + 1) * size]

    def _step(self, batch_frames: NDArray[np.int64], progress: float) -> None:
        factor = learning_rate_factor(progress, self.config.schedule, self.config.warmup)
        optimizers = [self.main] + ([self.scoring] if self.scoring else [])
        for optimizer in optimizers:
            for group in optimizer.param_groups:
                group["lr"] = self.config.learning_rate * factor
        batch = self.frames.batch(batch_frames).to(self.fabric.device)
        self.network.train()
        scores = progress >= self.config.scoring_start and self.step % self.config.scoring_every == 0
        found = self.module(batch, self.config.scoring_images if scores else 0)
        loss = losses.total(found, self.options.config.loss)
        self._check(loss, found)
        for optimizer in optimizers:
            optimizer.zero_grad(set_to_none=True)
        self.fabric.backward(loss)
        for part in (self.network.main_parameters(), self.network.scoring_parameters()):
            torch.nn.utils.clip_grad_norm_(list(part), self.config.clip_gradient)
        for optimizer in optimizers:
            optimizer.step()
        self.step += 1
        self.images += len(batch_frames)
        self._log(found, loss, factor)

    def _check(self, loss: Tensor, found: dict[str, Tensor]) -> None:
        if torch.isfinite(loss):
            return
        bad = ", ".join(name for name, value in found.items() if not torch.isfinite(value))
        raise InputError(
            f"{self.run.path}: the loss became NaN at step {self.step} (in: {bad}); the last checkpoint is kept: lower "
            "the learning rate with --learning-rate, in another folder."
        )

    def _log(self, found: dict[str, Tensor], loss: Tensor, factor: float) -> None:
        self.meter.add(float(loss.detach()))
        if self.step % LOG_EVERY == 0:
            values = {f"loss/{name}": float(value.detach()) for name, value in found.items()}
            rates = {"train/rate": factor, "train/images_per_second": self.meter.rate * self.config.batch_images}
            self.logger.log_metrics({"loss/total": float(loss.detach()), **values, **rates}, self.step)

    def _status(self) -> str:
        ap = f", AP {self.validations[-1]['ap']:.3f}" if self.validations else ""
        rate = self.meter.rate * self.config.batch_images
        return f"loss {self.meter.mean:.2f}, {self.images} images, {rate:.1f}/s{ap}"

    def _validation_due(self) -> bool:
        if len(self.split.validation) == 0:
            return False
        due = int(self.budget.progress(self.step) * self.config.validations)
        return due > len(self.validations) and due < self.config.validations

    def _validate(self, bar: tqdm[Any] | None = None) -> None:
        started = time.monotonic()
        result = validate(self.network, self.frames, self.split.validation, self.fabric.device)
        row = {"step": self.step, "images": self.images, "minutes": self.budget.seconds / 60, "ap": result.ap}
        row["validation_seconds"] = time.monotonic() - started
        self.validations.append(row)
        self.run.log_metrics(row)
        self.logger.log_metrics({"validation/ap": result.ap}, self.step)
        if bar is not None:
            bar.set_postfix_str(self._status())
        if result.ap >= self.best_ap:
            self.best_ap = result.ap
            self._save_model()

    def _finish(self) -> None:
        if len(self.split.validation):
            self._validate()
        else:
            self._save_model()
        self.finished = True
        self.save()
        self.logger.finalize("success")

    def _save_model(self) -> None:
        record = {
            "preset": self.options.config.preset,
            "seed": self.options.seed,
            "step": self.step,
            "images": self.images,
            "minutes": round(self.budget.seconds / 60, 2),
            "validation_ap": self.best_ap if self.best_ap >= 0 else None,
            "validation_images": len(self.split.validation),
            "protocol": "Sym, Siléane protocol, at least 50 % visible, scenes held out of the training shards",
            "data_sha256": data_hash(self.frames.dataset),
            "software": software_versions(),
        }
        save_model(self.run.model, self.network, record)


_BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}, {postfix}"


class _LossMeter:
    """Running mean of the loss, and steps a second."""

    def __init__(self, memory: float = 0.98) -> None:
        self.memory, self.mean, self.rate, self._last = memory, math.nan, 0.0, time.monotonic()

    def add(self, loss: float) -> None:
        now = time.monotonic()
        rate = 1.0 / max(now - self._last, 1e-6)
        self._last = now
        first = math.isnan(self.mean)
        self.mean = loss if first else self.memory * self.mean + (1 - self.memory) * loss
        self.rate = rate if first else self.memory * self.rate + (1 - self.memory) * rate


def _optimizers(network: PoseNetwork, config: Config) -> tuple[torch.optim.Optimizer, torch.optim.Optimizer | None]:
    """One for the multi-task network, one for what learns on its detached features."""
    kind = torch.optim.AdamW if config.train.optimizer == "adamw" else torch.optim.Adam

    def optimizer(parameters: list[torch.nn.Parameter]) -> torch.optim.Optimizer:
        return kind(parameters, lr=config.train.learning_rate, weight_decay=config.train.weight_decay, fused=True)

    scoring = list(network.scoring_parameters())
    return optimizer(list(network.main_parameters())), optimizer(scoring) if scoring else None
