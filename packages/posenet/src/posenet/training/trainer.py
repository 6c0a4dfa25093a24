"""The training loop: steps until the budget is spent, checkpoints, validation, the best model."""

from __future__ import annotations

import logging
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lightning_fabric.loggers import TensorBoardLogger
from tqdm import tqdm

from evalkit.errors import InputError
from posenet.device import choose_device, supports_bf16
from posenet.models.model_file import save_model
from posenet.network.pose_network import PoseNetwork
from posenet.optimizers.schedule import HASTE, Budget
from posenet.runs.history import ROW_EVERY, History
from posenet.runs.run_folder import RunFolder
from posenet.training.batches import Batches
from posenet.training.dataset import Frames, Split
from posenet.training.fit_options import FitOptions
from posenet.training.forecast import Forecast
from posenet.training.interruption import Interruption
from posenet.training.learner import Learner, NotFiniteError, StepLosses
from posenet.training.plateau import learns_nothing, no_longer_rises
from posenet.training.rank import ALONE, Rank
from posenet.training.record import training_record
from posenet.training.slowdown import Slowdown
from posenet.training.validation import validate
from posenet.training.validation_picture import draw_validation

log = logging.getLogger(__name__)

_BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}, {postfix}"


class Trainer:
    """Trains `network` on `split` of `frames` for the budget of `options`, and keeps all that it does in `run`.

    In each of several processes there is one, with its `rank`; all take the same steps, and the leader's alone writes.
    """

    def __init__(
        self,
        network: PoseNetwork,
        frames: Frames,
        split: Split,
        run: RunFolder,
        options: FitOptions,
        rank: Rank = ALONE,
    ) -> None:
        self.options, self.config = options, options.config.train
        self.frames, self.split, self.run, self.rank = frames, split, run, rank
        device = choose_device(options.device)
        network.bf16 = self.config.precision == "bf16" or (self.config.precision == "auto" and supports_bf16(device))
        self.logger = TensorBoardLogger(run.path, name="", version="")
        self.fabric = rank.fabric(device, self.logger)
        self.learner = Learner(network, options.config, self.fabric, rank)
        self.network = self.learner.network
        self.batches = Batches(frames, split.train, self.config, options.seed, rank)
        self.step, self.images, self.best_ap, self.finished = 0, 0, -1.0, False
        self.validations: list[dict[str, float]] = []
        self.validations_due, self.judged_from, self.warned = 0, 0, False
        self.history, self.slowdown, self.forecast = History(), Slowdown(), Forecast()
        self.budget = self._budget()

    def train(self) -> None:
        """Run to the end of the budget; a finished run trains no more.

        Raises:
            KeyboardInterrupt: Ctrl-C or SIGTERM, after the state was saved, and a model if there is none yet.
            InputError: nothing is learned, or the loss became NaN.
        """
        if self.finished:
            minutes = self.budget.seconds / 60
            log.info("This run has ended, after %.1f minutes; give it more --minutes in all to go on.", minutes)
            return
        try:
            return self._lead() if self.rank.leads else self._follow()
        finally:
            self.batches.close()

    def _lead(self) -> None:
        """Take steps, show and keep what comes of them."""
        bar = tqdm(total=100.0, desc="fit", bar_format=_BAR, mininterval=0.5)
        with Interruption() as interruption, bar:
            try:
                self._run(interruption, bar)
            except KeyboardInterrupt:
                with interruption.held():
                    self.save()
                    if self.step and not self.run.model.exists():
                        with self.learner.averaged():
                            self._keep_models(better=True)
                raise

    def take_step(self, progress: float) -> None:
        """Take the next step, `progress` (0 to 1) into the run."""
        batch = self.batches.load(self.step, self.fabric.device)
        with self._not_finite_as_a_sentence():
            measured = self.learner.take_step(batch, self.step, progress)
        self.images += len(self.batches.frame_numbers(self.step))
        self.step += 1
        if self.rank.leads:
            self._log(measured, progress)

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
                "validations_due": self.validations_due,
                "judged_from": self.judged_from,
                "warned": self.warned,
                "hurried_from": self.budget.hurried_from,
                "budget": self.budget.length,
                **self.learner.state(),
            }
        )

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.learner.restore(state)
        self.step, self.images, self.best_ap = state["step"], state["images"], state["best_ap"]
        self.validations, self.finished = state["validations"], state["finished"]
        self.history.rows = state.get("history", [])
        self.validations_due = state.get("validations_due", len(self.validations))
        self.judged_from, self.warned = state.get("judged_from", 0), state.get("warned", False)
        self.budget.spent_before = state["seconds"]
        if state.get("budget", self.budget.length) == self.budget.length:
            self.budget.hurried_from = state.get("hurried_from")
        else:
            self._extend()

    def _extend(self) -> None:
        """Go on with another budget than the one so far."""
        if self.budget.progress(self.step) >= 1.0:
            raise InputError(
                f"{self.run.path}: has trained for {self.budget.seconds / 60:.1f} minutes, {self.images} images "
                "already; give more than that in all, as in --minutes "
                f"{math.ceil(self.budget.seconds / 60) * 2:g}."
            )
        self.finished = False
        self.validations_due = self._due()
        self.judged_from = len(self.validations)  # AP falls at first, for the learning rate has risen again

    def _due(self) -> int:
        """How many validations the run should have made."""
        return int(self.budget.progress(self.step) * self.config.validations)

    def _follow(self) -> None:
        """Take the leader's steps with it."""
        while (progress := self._progress()) < 1.0:
            self.take_step(progress)

    def _run(self, interruption: Interruption, bar: tqdm[Any]) -> None:
        saved = time.monotonic()
        while True:
            with interruption.held():
                progress = self._progress()
                if progress < 1.0:
                    self.take_step(progress)
            if progress >= 1.0:
                break
            self._show(bar)
            validated = self._validation_due()
            if validated:
                self._validate(interruption)
                self._judge(interruption)
            if validated or time.monotonic() - saved > self.options.checkpoint_seconds:
                with interruption.held():
                    self.save()
                saved = time.monotonic()
        self._finish(interruption)
        self._show(bar)

    def _progress(self) -> float:
        """Share of the run that is done, by the leader's clock."""
        return self.rank.from_leader(self.budget.progress(self.step), self.fabric.device)

    def _budget(self) -> Budget:
        options, config = self.options, self.config
        if options.minutes is not None:
            return Budget(minutes=options.minutes)
        if options.epochs is None and config.images:
            return Budget(steps=max(1, config.images // config.batch_images), minutes=config.minutes)
        return Budget(steps=(options.epochs or config.epochs) * self.batches.steps_per_epoch)

    @contextmanager
    def _not_finite_as_a_sentence(self) -> Iterator[None]:
        try:
            yield
        except NotFiniteError as parts:
            raise InputError(
                f"{self.run.path}: the loss became NaN at step {self.step} (in: {parts}); the last checkpoint is kept: "
                "lower the learning rate with --learning-rate, in another folder."
            ) from None

    def _log(self, measured: StepLosses, progress: float) -> None:
        self.history.add({name: mean.value for name, mean in measured.parts.items()}, measured.total)
        if self.step % ROW_EVERY == 0:
            row = self.history.close_row(**self._position())
            values = {f"loss/{name}": value for name, value in row.items() if name == "total" or name in measured.parts}
            factor = self.learner.learning_rate_factor(progress)
            rates = {"train/rate": factor, "train/images_per_second": self.history.rate * self.config.batch_images}
            self.logger.log_metrics({**values, **rates}, self.step)

    def _position(self) -> dict[str, float]:
        return {
            "step": self.step,
            "images": self.images,
            "minutes": self.budget.seconds / 60,
            "progress": self.budget.progress(self.step),
        }

    def _show(self, bar: tqdm[Any]) -> None:
        ap = f", AP {self.validations[-1]['ap']:.3f}" if self.validations else ""
        rate = self.history.rate * self.config.batch_images
        if sentence := self.forecast.after_step(self.budget, self.step, self.config.batch_images):
            log.info(sentence)
        if warning := self.slowdown.warning(rate):
            bar.write(warning, file=sys.stderr)
        bar.n = 100.0 * self.budget.progress(self.step)
        bar.set_postfix_str(f"loss {self.history.mean:.2f}, {self.images} images, {rate:.1f}/s{ap}", refresh=False)
        bar.update(0)

    def _validated_now(self) -> bool:
        """Whether the last validation was of the weights as they are."""
        return bool(self.validations) and self.validations[-1]["step"] == self.step

    def _validation_due(self) -> bool:
        if len(self.split.validation) == 0:
            return False
        return self.validations_due < self._due() < self.config.validations

    def _validate(self, interruption: Interruption) -> None:
        """Measure AP, then note it and keep the models; what is interrupted while measuring is measured again."""
        started = time.monotonic()
        with self.learner.averaged():
            result = validate(self.network, self.frames, self.split.validation, self.fabric.device)
            picture = draw_validation(self.network, self.frames, int(self.split.validation[0]), self.fabric.device)
            with interruption.held():
                seconds = time.monotonic() - started
                self.validations_due = self._due()
                self.validations.append({**self._position(), **result._asdict(), "validation_seconds": seconds})
                self._keep_models(better=result.ap >= self.best_ap)
                self.run.write_progress(self.history.rows, self.validations)
                self.logger.log_metrics({"validation/ap": result.ap}, self.step)
                self.logger.experiment.add_image("validation/poses", picture, self.step, dataformats="HWC")

    def _judge(self, interruption: Interruption) -> None:
        """Make haste when held-out AP no longer rises; stop, once, when nothing is learned."""
        if self.config.schedule == "constant":
            return
        if self.budget.hurried_from is None and no_longer_rises(self.validations[self.judged_from :]):
            self.budget.hurry(self.step)
            log.info("Held-out AP no longer rises: the rest of the schedule goes %g times faster.", HASTE)
        problem = learns_nothing(self.validations[-1])
        if problem and not self.warned:
            self.warned = True
            with interruption.held():
                self.save()
            raise InputError(
                f"{self.run.path}: {problem}, so it stops here instead of spending the rest of its time; look at the "
                "shards with 'simgen preview' (are objects to be seen, is the depth in meters?), at curves.png in the "
                "run's folder, and try a lower --learning-rate; the same command again goes on regardless."
            )

    def _finish(self, interruption: Interruption) -> None:
        if len(self.split.validation) and not self._validated_now():
            self._validate(interruption)
        with interruption.held():
            if not len(self.split.validation):
                with self.learner.averaged():
                    self._keep_models(better=True)
                self.run.write_progress(self.history.rows, self.validations)
            self.finished = True
            self.save()
            self.logger.finalize("success")

    def _keep_models(self, better: bool) -> None:
        """Write the last model, and the best one where this one is `better`."""
        ap = self.validations[-1]["ap"] if self.validations else None
        record = training_record(self.options, self.frames.dataset, len(self.split.validation), ap, **self._position())
        save_model(self.run.last, self.network, record)
        if better:
            self.best_ap = ap if ap is not None else self.best_ap
            save_model(self.run.model, self.network, record)
