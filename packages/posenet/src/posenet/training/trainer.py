"""The training loop: batches in a reproducible order, two optimisers, checkpoints, validation, the best model."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
import torch
from lightning_fabric.loggers import TensorBoardLogger
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from evalkit.errors import InputError
from posenet.device import choose_device, supports_bf16
from posenet.layers.mean import Mean
from posenet.models.model_file import save_model
from posenet.network import losses
from posenet.network.pose_network import PoseNetwork
from posenet.network.targets import Batch
from posenet.optimizers.build import build_optimizers
from posenet.optimizers.ema import WeightAverage
from posenet.optimizers.schedule import Budget, learning_rate_factor
from posenet.runs.history import ROW_EVERY, History
from posenet.runs.provenance import data_hash, git_version, software_versions
from posenet.runs.run_folder import RunFolder
from posenet.training.augment import Degradation, degrade, generator_of
from posenet.training.dataset import Frames, Split, epoch_order, step_seeds
from posenet.training.fit_options import FitOptions
from posenet.training.interruption import Interruption
from posenet.training.processes import ALONE, Place
from posenet.training.slowdown import Slowdown
from posenet.training.validation import validate
from posenet.training.validation_picture import draw_validation

_BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}, {postfix}"


class Trainer:
    """Trains `network` on `split` of `frames` for the budget of `options`, and keeps all that it does in `run`.

    In each of several processes there is one, at its `place`; all take the same steps, and the leader's alone writes.
    """

    def __init__(
        self,
        network: PoseNetwork,
        frames: Frames,
        split: Split,
        run: RunFolder,
        options: FitOptions,
        place: Place = ALONE,
    ) -> None:
        self.options, self.config = options, options.config.train
        self.frames, self.split, self.run = frames, split, run
        device = choose_device(options.device)
        network.bf16 = self.config.precision == "bf16" or (self.config.precision == "auto" and supports_bf16(device))
        self.place = place
        self.logger = TensorBoardLogger(run.path, name="", version="")
        self.fabric = place.fabric(device, self.logger)
        self.network = network.in_fast_layout()
        main, scoring = build_optimizers(network, self.config)
        self.module, self.main, *rest = self.fabric.setup(self.network, main, *([scoring] if scoring else []))
        self.scoring = rest[0] if rest else None
        self.average = WeightAverage(self.network, self.config.ema) if self.config.ema > 0 and place.leads else None
        self.step, self.images, self.best_ap, self.finished = 0, 0, -1.0, False
        self.validations: list[dict[str, float]] = []
        self.history, self.slowdown = History(), Slowdown()
        self.budget = self._budget()

    def train(self) -> None:
        """Run to the end of the budget; a finished run trains no more.

        Raises:
            KeyboardInterrupt: Ctrl-C or SIGTERM, after the state was saved.
        """
        if self.finished:
            return
        if not self.place.leads:
            return self._follow()
        bar = tqdm(total=100.0, desc="fit", bar_format=_BAR, mininterval=0.5)
        with Interruption() as interruption, bar:
            try:
                self._run(interruption, bar)
            except KeyboardInterrupt:
                with interruption.held():
                    self.save()
                raise

    def save(self) -> None:
        """Write the checkpoint: all that the next step depends on. Images and what is drawn follow from the step."""
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
        self.step, self.images, self.best_ap = state["step"], state["images"], state["best_ap"]
        self.validations, self.finished = state["validations"], state["finished"]
        self.history.rows = state.get("history", [])
        self.budget.spent_before = state["seconds"]

    def _follow(self) -> None:
        """Take the leader's steps with it."""
        for batch_frames in self._batches():
            progress = self._progress()
            if progress >= 1.0:
                return
            self._step(batch_frames, progress)

    def _run(self, interruption: Interruption, bar: tqdm[Any]) -> None:
        saved = time.monotonic()
        for batch_frames in self._batches():
            with interruption.held():
                progress = self._progress()
                if progress < 1.0:
                    self._step(batch_frames, progress)
            if progress >= 1.0:
                break
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

    def _progress(self) -> float:
        """Share of the run that is done, by the leader's clock."""
        return self.place.told(self.budget.progress(self.step), self.fabric.device)

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
        found = self.module(batch, self._scoring_images if scores else 0)
        whole = self.place.summed(found)
        total = losses.total(whole, self.options.config.loss)
        self._require_finite(total, {name: mean.total for name, mean in whole.items()})
        self.fabric.backward(self._to_minimise(found, whole))
        for part in (self.network.main_parameters(), self.network.scoring_parameters()):
            norm = torch.nn.utils.clip_grad_norm_(list(part), self.config.clip_gradient)
            self._require_finite(norm, {"gradient": norm})
        self.main.step()
        if self.scoring and scores:
            self.scoring.step()
        self.step += 1
        self.images += len(batch_frames)
        if self.average:
            self.average.update(self.network)
        if self.place.leads:
            self._log(whole, total, factor)

    def _to_minimise(self, found: dict[str, Mean], whole: dict[str, Mean]) -> Tensor:
        """This process's loss, from its own sums and the counts of all."""
        if self.place.size == 1:
            return losses.total(found, self.options.config.loss)
        # DDP takes the mean of all processes' gradients, of what are addends here, and waits for every parameter's.
        addend = losses.total(found, self.options.config.loss, whole)
        nothing = torch.stack([parameter.sum() for parameter in self.network.parameters()]).sum() * 0.0
        return addend * self.place.size + nothing

    @property
    def _scoring_images(self) -> int:
        """How many of this process's images train the scores: its share, but one at least, so that all take part."""
        return max(1, len(self.place.share(range(self.config.scoring_images))))

    def _batch(self, batch_frames: NDArray[np.int64]) -> Batch:
        """This process's share of a batch, degraded where the configuration says so."""
        seed, step, share = self.options.seed, self.step, self.place.share
        torch.manual_seed(step_seeds(seed, step, np.array([self.place.rank]))[0])  # of dropout, which draws globally
        seeds = step_seeds(seed, step, batch_frames)
        batch = self.frames.batch(share(batch_frames), share(seeds)).to(self.fabric.device)
        bounds = Degradation(self.config.augment_noise, self.config.augment_holes)
        if not any(bounds):
            return batch
        diameter = self.frames.model.diameter
        images = [
            degrade(image, bounds, diameter, generator_of(seed, step, i))
            for i, image in zip(share(range(len(batch_frames))), batch.depth, strict=True)
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

    def _log(self, found: dict[str, Mean], loss: Tensor, factor: float) -> None:
        self.history.add({name: mean.value for name, mean in found.items()}, loss)
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
        if sentence := self.slowdown.told(rate):
            bar.write(sentence, file=sys.stderr)
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
