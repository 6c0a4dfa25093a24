"""Two processes that share every batch train what one process trains."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from evalkit.errors import InputError
from posenet.config import Config, preset, with_options
from posenet.layers.mean import Mean
from posenet.models.model_file import read_torch_file
from posenet.training.dataset import Frames, step_seeds
from posenet.training.fit_options import FitOptions
from posenet.training.processes import processes
from posenet.training.rank import Rank
from posenet.training.train import fit
from posenet.training.trainer import Trainer

LONGEST_WAIT = 60.0  # seconds; the machine may be busy


@pytest.fixture(autouse=True)
def _one_thread() -> object:
    """Networks this small are slower on two threads, and far slower where the machine is shared."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def config(name: str) -> Config:
    """Of few parameters, in float32, with every loss from the first step on."""
    chosen = preset("debug" if name == "debug" else "paper")
    network = {"backbone": "vgg_debug", "fc_width": 64, "dropout": 0.0, "registration_blocks": 1}
    chosen = with_options(chosen, "network", **network)
    train = {"batch_images": 3, "scoring_images": 2, "scoring_start": 0.0, "scoring_every": 2, "rois_per_image": 4}
    return with_options(chosen, "train", precision="32", learning_rate=1e-3, schedule="cosine", **train)


def options(shards: Path, out: Path, chosen: Config, devices: int, **rest: Any) -> FitOptions:
    return FitOptions(
        [shards], out, chosen, **{"epochs": 2, "device": "cpu", "validate": False, "devices": devices} | rest
    )


def gradients_and_weights(
    chosen: FitOptions, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[Tensor], dict[str, Tensor], list[dict[str, float]]]:
    """Of the first step the multi-task network's gradients; of the run the weights it ends with and its losses."""
    first: list[Tensor] = []
    clip = torch.nn.utils.clip_grad_norm_

    def noted(parameters: list[Tensor], most: float) -> Tensor:
        if not first:
            first.extend(p.grad.clone() for p in parameters if p.grad is not None)
        return clip(parameters, most)

    with monkeypatch.context() as patch:
        patch.setattr(torch.nn.utils, "clip_grad_norm_", noted)
        patch.setattr("posenet.training.trainer.ROW_EVERY", 1)
        run = fit(chosen)
    state = read_torch_file(run.checkpoint)
    return first, state["weights"], state["history"]


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """As a command that somebody typed: one that a shell started in the background is deaf to interruptions."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("name", ["debug", pytest.param("paper", marks=pytest.mark.slow)])
def test_two_processes_end_with_the_weights_of_one(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Batches of three: one process has two images, the other one, and unequal numbers of instances."""
    results = [
        gradients_and_weights(options(debug_shards, tmp_path / str(n), config(name), n), monkeypatch) for n in (1, 2)
    ]
    (gradient, weights, losses), (other_gradient, other_weights, other_losses) = results
    difference = torch.cat([(a - b).flatten() for a, b in zip(gradient, other_gradient, strict=True)]).norm()
    assert difference < 5e-3 * torch.cat([a.flatten() for a in gradient]).norm()
    for row, other in zip(losses, other_losses, strict=True):
        assert row["step"] == other["step"] and set(row) == set(other)
        assert row["total"] == pytest.approx(other["total"], rel=2e-3)
    for key, value in weights.items():
        # Adam makes a step of full length of a gradient that rounding alone decides: in few places, by that much.
        apart = (value.float() - other_weights[key].float()).abs()
        assert float(apart.mean()) < 3e-4, key


@pytest.mark.slow
def test_batch_statistics_are_those_of_all_images(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = with_options(config("debug"), "train", learning_rate=1e-9)
    one, two = (
        gradients_and_weights(options(debug_shards, tmp_path / str(n), chosen, n), monkeypatch)[1] for n in (1, 2)
    )
    for key in (key for key in one if "running" in key or "num_batches" in key):
        torch.testing.assert_close(one[key], two[key], rtol=1e-4, atol=1e-5, msg=key)


def test_a_killed_run_of_two_goes_on_bit_for_bit_even_where_one_was_killed(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = fit(options(debug_shards, tmp_path / "whole", config("debug"), 2))
    stopped = options(debug_shards, tmp_path / "stopped", config("debug"), 2, checkpoint_seconds=0.0)
    take = Trainer.take_step

    def kill_the_other_at_two(self: Trainer, progress: float) -> None:
        if self.step == 2:
            import multiprocessing

            for child in multiprocessing.active_children():
                os.kill(child.pid or 0, signal.SIGKILL)
        take(self, progress)

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "take_step", kill_the_other_at_two)
        with pytest.raises(
            InputError, match=r"process 2 of 2 was killed by signal 9.*run the same command again"
        ) as caught:
            fit(stopped)
    assert "\n" not in str(caught.value)
    assert not torch.distributed.is_initialized()
    resumed = fit(stopped)
    a, b = (read_torch_file(run.checkpoint) for run in (whole, resumed))
    assert a["step"] == b["step"] == 4
    assert all(torch.equal(a["weights"][key], b["weights"][key]) for key in a["weights"])


def test_a_batch_too_small_to_share_is_refused(debug_shards: Path, tmp_path: Path) -> None:
    chosen = with_options(config("debug"), "train", batch_images=1)
    with pytest.raises(InputError, match="give --batch-images 2 or more"):
        fit(options(debug_shards, tmp_path / "run", chosen, 2))
    assert not (tmp_path / "run").exists()


def fails_with_a_sentence(rank: Rank) -> None:
    rank.fabric(torch.device("cpu"), None)
    raise InputError("shard-00001.h5: is gone.")


def test_a_mistake_that_another_process_meets_is_reported_as_if_the_first_had_met_it() -> None:
    with pytest.raises(InputError, match=r"shard-00001\.h5: is gone\."), processes(2, fails_with_a_sentence) as rank:
        fabric = rank.fabric(torch.device("cpu"), None)
        rank.from_leader(0.0, fabric.device)
        rank.from_leader(0.0, fabric.device)


def fails_with_a_bug(rank: Rank) -> None:
    raise ZeroDivisionError("of an image without pixels")


def is_killed(rank: Rank) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize(
    ("work", "says"),
    [
        (fails_with_a_bug, r"process 2 of 2 failed \(ZeroDivisionError: of an image without pixels\)"),
        (is_killed, "process 2 of 2 was killed by signal 9"),
    ],
)
def test_whatever_ends_another_process_ends_the_first_within_seconds_even_between_steps(
    work: Callable[[Rank], None], says: str
) -> None:
    with pytest.raises(InputError, match=says), processes(2, work):
        started = time.monotonic()
        while time.monotonic() - started < LONGEST_WAIT:  # the leader validates, say: nothing tells it of the other
            time.sleep(0.05)
    assert time.monotonic() - started < LONGEST_WAIT


STUCK = """
import os, signal, threading
from posenet.training.processes import processes

def work(rank):
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    with processes(2, work):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a collective that waits in a library takes no interruption
        threading.Event().wait()
"""


def test_a_first_process_that_cannot_be_interrupted_ends_with_the_sentence_and_a_code(tmp_path: Path) -> None:
    script = tmp_path / "stuck.py"
    script.write_text(STUCK)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 2
    assert "process 2 of 2 was killed by signal 9" in done.stderr and "Traceback" not in done.stderr


def test_shares_are_dealt_so_that_the_first_images_come_first_everywhere() -> None:
    ranks = [Rank(index, 3) for index in range(3)]
    assert [rank.share([0, 1, 2, 3, 4, 5, 6]) for rank in ranks] == [[0, 3, 6], [1, 4], [2, 5]]


def test_an_image_draws_the_same_whatever_shares_its_batch(debug_shards: Path) -> None:
    frames = Frames(debug_shards)
    together = frames.batch(np.array([0, 1, 2]), step_seeds(7, 5, np.array([0, 1, 2]))).draws()
    alone = frames.batch(np.array([2]), step_seeds(7, 5, np.array([2]))).draws()
    assert torch.equal(torch.rand(3, generator=together[2]), torch.rand(3, generator=alone[0]))
    seeds = {step_seeds(seed, step, np.array([frame]))[0] for seed in (0, 1) for step in (0, 1) for frame in (0, 1)}
    assert len(seeds) == 8


def test_means_of_shares_are_the_mean_of_the_whole() -> None:
    values = torch.tensor([1.0, 2.0, 3.0, 10.0])
    parts = [Mean.of(values[:1]), Mean.of(values[1:]), Mean.of(values[:0])]
    whole = Mean(sum(part.total for part in parts), sum(part.over for part in parts))  # type: ignore[arg-type]
    assert float(whole.value) == 4.0
    assert float(Mean.of(values[:0]).value) == 0.0
