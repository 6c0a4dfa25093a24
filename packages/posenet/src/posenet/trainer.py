"""The training loop: batches in a reproducible order, two optimisers, checkpoints, validation, the best model."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
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
from posenet.augment import Degradation, degrade, generator_of
from posenet.config import Config
from posenet.dataset import Frames, Split, epoch_order
from posenet.device import choose_device, supports_bf16
from posenet.ema import WeightAverage
from posenet.fit_options import FitOptions
from posenet.history import ROW_EVERY, History
from posenet.interruption import Interruption
from posenet.model_file import save_model
from posenet.network import PoseNetwork
from posenet.provenance import data_hash, git_version, software_versions
from posenet.run_folder import RunFolder
from posenet.schedule import Budget, learning_rate_factor
from posenet.targets import Batch
from posenet.validation import validate
from posenet.validation_picture import draw_validation

_BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}, {postfix}"


class Trainer:
    """Trains `network` on `split` of `frames` for the budget of `options`, and keeps all that it does in `run`."""

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
        self.average = WeightAverage(self.network, self.config.ema) if self.config.ema > 0 else None
        self.step, self.images, self.best_ap, self.finished = 0, 0, -1.0, False
        self.validations: list[dict[str, float]] = []
        self.history = History()
        self.budget = self._budget()

    def train(self) -> None:
        """Run to the end of the budget; a finished run trains no more.

        Raises:
            KeyboardInterrupt: Ctrl-C or SIGTERM, after the state was saved.
        """
        if self.finished:
            return
        bar = tqdm(total=100.0, desc="fit", bar_format=_BAR, mininterval=0.5)
        with Interruption() as interruption, bar:
            try:
                self._run(interruption, bar)
            except KeyboardInterrupt:
                with interruption.held():
                    self.save()
                raise

    def save(self) -> None:
        """Write the checkpoint: all that the next step depends on. The order of images follows from the step."""
        self.run.save_checkpoint(
            {
                "step": self.step,
                "images": self.images,
                "seconds": self.budget.seconds,
                "best_ap": self.best_ap,
                "validations": self.validations,
                "history": self.history.rows,
                "finished": self.finished,
                "weights": self.network.state_dict(),
                "average": self.average.state() if self.average else None,
                "main": self.main.state_dict(),
                "scoring": self.scoring.state_dict() if self.scoring else None,
                "random": torch.get_rng_state(),
                "random_cuda": torch.cuda.get_rng_state_all() if self.fabric.device.type == "cuda" else None,
            }
        )

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.network.load_state_dict(state["weights"])
        self.main.load_state_dict(state["main"])
        if self.scoring and state["scoring"]:
            self.scoring.load_state_dict(state["scoring"])
        if self.average and state.get("average"):
            self.average.restore(state["average"])
        torch.set_rng_state(state["random"])
        if state.get("random_cuda") and self.fabric.device.type == "cuda":
            torch.cuda.set_rng_state_all(state["random_cuda"])
        self.step, self.images, self.best_ap = state["step"], state["images"], state["best_ap"]
        self.validations, self.finished = state["validations"], state["finished"]
        self.history.rows = state.get("history", [])
        self.budget.spent_before = state["seconds"]

    def _run(self, interruption: Interruption, bar: tqdm[Any]) -> None:
        saved = time.monotonic()
        for batch_frames in self._batches():
            progress = self.budget.progress(self.step)
            if progress >= 1.0:
                break
            with interruption.held():
                self._step(batch_frames, progress)
            self._show(bar)
            validated = self._validation_due()
            if validated:
                self._validate(interruption)
            if validated or time.monotonic() - saved > self.options.checkpoint_seconds:
                with interruption.held():
                    self.save()
                saved = time.monotonic()
        self._finish(interruption)
        self._show(bar)

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

    @property
    def _optimizers(self) -> list[Any]:
        return [self.main] + ([self.scoring] if self.scoring else [])

    def _step(self, batch_frames: NDArray[np.int64], progress: float) -> None:
        factor = learning_rate_factor(progress, self.config.schedule, self.config.warmup)
        for optimizer in self._optimizers:
            for group in optimizer.param_groups:
                group["lr"] = group["initial_lr"] * factor
            optimizer.zero_grad(set_to_none=True)
        batch = self._batch(batch_frames)
        self.network.train()
        scores = progress >= self.config.scoring_start and self.step % self.config.scoring_every == 0
        found = self.module(batch, self.config.scoring_images if scores else 0)
        loss = losses.total(found, self.options.config.loss)
        self._require_finite(loss, found)
        self.fabric.backward(loss)
        for part in (self.network.main_parameters(), self.network.scoring_parameters()):
            norm = torch.nn.utils.clip_grad_norm_(list(part), self.config.clip_gradient)
            self._require_finite(norm, {"gradient": norm})
        for optimizer in self._optimizers:
            optimizer.step()
        self.step += 1
        self.images += len(batch_frames)
        if self.average:
            self.average.update(self.network)
        self._log(found, loss, factor)

    def _batch(self, batch_frames: NDArray[np.int64]) -> Batch:
        batch = self.frames.batch(batch_frames).to(self.fabric.device)
        bounds = Degradation(self.config.augment_noise, self.config.augment_holes)
        if not any(bounds):
            return batch
        diameter = self.frames.model.diameter
        images = [
            degrade(image, bounds, diameter, generator_of(self.options.seed, self.step, i))
            for i, image in enumerate(batch.depth)
        ]
        return batch._replace(depth=torch.stack(images))

    def _require_finite(self, value: Tensor, parts: dict[str, Tensor]) -> None:
        if torch.isfinite(value):
            return
        bad = ", ".join(name for name, part in parts.items() if not torch.isfinite(part))
        raise InputError(
            f"{self.run.path}: the loss became NaN at step {self.step} (in: {bad}); the last checkpoint is kept: lower "
            "the learning rate with --learning-rate, in another folder."
        )

    def _log(self, found: dict[str, Tensor], loss: Tensor, factor: float) -> None:
        self.history.add(found, loss)
        if self.step % ROW_EVERY == 0:
            row = self.history.close_row(**self._place())
            values = {f"loss/{name}": value for name, value in row.items() if name == "total" or name in found}
            rates = {"train/rate": factor, "train/images_per_second": self.history.rate * self.config.batch_images}
            self.logger.log_metrics({**values, **rates}, self.step)

    def _place(self) -> dict[str, float]:
        return {"step": self.step, "images": self.images, "minutes": self.budget.seconds / 60}

    def _show(self, bar: tqdm[Any]) -> None:
        ap = f", AP {self.validations[-1]['ap']:.3f}" if self.validations else ""
        rate = self.history.rate * self.config.batch_images
        bar.n = 100.0 * self.budget.progress(self.step)
        bar.set_postfix_str(f"loss {self.history.mean:.2f}, {self.images} images, {rate:.1f}/s{ap}", refresh=False)
        bar.update(0)

    def _validation_due(self) -> bool:
        if len(self.split.validation) == 0:
            return False
        due = int(self.budget.progress(self.step) * self.config.validations)
        return due > len(self.validations) and due < self.config.validations

    def _averaged(self) -> AbstractContextManager[None]:
        """The weights that are validated and kept: the moving average, where there is one."""
        return self.average.in_place_of(self.network) if self.average else nullcontext()

    def _validate(self, interruption: Interruption) -> None:
        """Measure AP, then note it and keep the models; what is interrupted while measuring is measured again."""
        started = time.monotonic()
        with self._averaged():
            result = validate(self.network, self.frames, self.split.validation, self.fabric.device)
            picture = draw_validation(self.network, self.frames, int(self.split.validation[0]), self.fabric.device)
            with interruption.held():
                seconds = time.monotonic() - started
                self.validations.append({**self._place(), "ap": result.ap, "validation_seconds": seconds})
                self._keep_models(better=result.ap >= self.best_ap)
                self.run.write_progress(self.history.rows, self.validations)
                self.logger.log_metrics({"validation/ap": result.ap}, self.step)
                self.logger.experiment.add_image("validation/poses", picture, self.step, dataformats="HWC")

    def _finish(self, interruption: Interruption) -> None:
        if len(self.split.validation):
            self._validate(interruption)
        with interruption.held():
            if not len(self.split.validation):
                with self._averaged():
                    self._keep_models(better=True)
                self.run.write_progress(self.history.rows, self.validations)
            self.finished = True
            self.save()
            self.logger.finalize("success")

    def _keep_models(self, better: bool) -> None:
        """Write the last model, and the best one where this one is `better`."""
        ap = self.validations[-1]["ap"] if self.validations else None
        record = self._record(ap)
        save_model(self.run.last, self.network, record)
        if better:
            self.best_ap = ap if ap is not None else self.best_ap
            save_model(self.run.model, self.network, record)

    def _record(self, ap: float | None) -> dict[str, Any]:
        return {
            "preset": self.options.config.preset,
            "seed": self.options.seed,
            "step": self.step,
            "images": self.images,
            "minutes": round(self.budget.seconds / 60, 2),
            "validation_ap": ap,
            "validation_images": len(self.split.validation),
            "protocol": "Sym, Siléane protocol, at least 50 % visible, scenes held out of the training shards",
            "data_sha256": data_hash(self.frames.dataset),
            "command": self.options.command,
            "git": git_version(),
            "software": software_versions(),
        }


def _optimizers(network: PoseNetwork, config: Config) -> tuple[torch.optim.Optimizer, torch.optim.Optimizer | None]:
    """One for the multi-task network, one for what learns on its detached features."""
    kind = torch.optim.AdamW if config.train.optimizer == "adamw" else torch.optim.Adam

    def optimizer(parameters: list[torch.nn.Parameter], rate: float) -> torch.optim.Optimizer:
        group = {"params": parameters, "initial_lr": rate}
        return kind([group], lr=rate, weight_decay=config.train.weight_decay, fused=True)

    rate = config.train.learning_rate
    scoring = list(network.scoring_parameters())
    main = optimizer(list(network.main_parameters()), rate)
    return main, optimizer(scoring, rate * config.train.scoring_rate) if scoring else None
