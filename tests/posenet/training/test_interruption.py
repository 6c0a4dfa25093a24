"""Signals wait for the end of what must be done whole, and a run stopped by any of them goes on as if it had not."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from posenet.models.model_file import load_model, read_torch_file
from posenet.training.interruption import Interruption

LONGEST_WAIT = 500  # seconds; the machine may be busy


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_the_end_of_a_step(number: signal.Signals) -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), Interruption() as interruption:
        with interruption.held():
            os.kill(os.getpid(), number)
            done.append("the whole step")
        done.append("never reached")
    assert done == ["the whole step"]


def test_between_steps_a_signal_stops_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), Interruption():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10)


def test_afterwards_signals_do_what_they_did_before() -> None:
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with Interruption():
        assert signal.getsignal(signal.SIGTERM) != before[1]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def start(shards: Path, out: Path, epochs: int, threads: int) -> subprocess.Popen[str]:
    words = [Path(sys.executable).with_name("posenet"), "fit", shards, "-o", out, "--preset", "debug"]
    words += ["--epochs", epochs, "--batch-images", 1, "--checkpoint-seconds", 0.1, "--device", "cpu"]
    words += ["--ema", 0.9, "--no-validation"]
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
    return subprocess.Popen([str(word) for word in words], stderr=subprocess.PIPE, text=True, env=environment)


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Its exit code and what it said; no process outlives its test."""
    try:
        _, said = process.communicate(timeout=LONGEST_WAIT)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, said


def wait_for_a_new_checkpoint(process: subprocess.Popen[str], out: Path) -> None:
    file = out / "checkpoint.pt"
    before = file.stat().st_mtime_ns if file.exists() else 0
    end = time.monotonic() + LONGEST_WAIT
    while process.poll() is None and time.monotonic() < end:
        if file.exists() and file.stat().st_mtime_ns != before:
            return
        time.sleep(0.01)


def stop_and_resume(shards: Path, folder: Path, signals: list[signal.Signals], epochs: int, threads: int) -> None:
    """A run that is stopped by each signal in turn, at random moments, ends as one that never was."""
    whole, stopped = folder / "whole", folder / "stopped"
    assert finish(start(shards, whole, epochs, threads))[0] == 0
    for number in signals:
        process = start(shards, stopped, epochs, threads)
        wait_for_a_new_checkpoint(process, stopped)
        time.sleep(random.uniform(0, 0.4))
        assert process.poll() is None, "the run ended before it could be stopped: give it more epochs"
        sent = time.monotonic()
        process.send_signal(number)
        code, said = finish(process)
        if number != signal.SIGKILL:
            assert code == 130, said
            assert "run the same command again" in said and "Traceback" not in said
            assert time.monotonic() - sent < 30
            assert load_model(stopped).network.config.preset == "debug", "what Ctrl-C leaves can predict"
    assert finish(start(shards, stopped, epochs, threads))[0] == 0
    for name in ("model.pt", "last.pt"):
        a, b = (read_torch_file(run / name)["weights"] for run in (whole, stopped))
        assert all(torch.equal(a[key], b[key]) for key in a), name
    a, b = (read_torch_file(run / "checkpoint.pt") for run in (whole, stopped))
    assert all(torch.equal(a["weights"][key], b["weights"][key]) for key in a["weights"])
    assert a["step"] == b["step"]
    assert [row["step"] for row in a["history"]] == [row["step"] for row in b["history"]]
    assert not list(stopped.glob("*.tmp"))


def test_a_run_stopped_by_any_signal_at_any_moment_ends_bit_for_bit_the_same(
    debug_shards: Path, tmp_path: Path
) -> None:
    stop_and_resume(debug_shards, tmp_path, [signal.SIGKILL, signal.SIGINT], epochs=8, threads=1)


@pytest.mark.slow
def test_a_run_killed_ten_times_ends_bit_for_bit_the_same(debug_shards: Path, tmp_path: Path) -> None:
    signals = [signal.SIGKILL] * 8 + [signal.SIGTERM, signal.SIGINT]
    stop_and_resume(debug_shards, tmp_path, signals, epochs=40, threads=2)
