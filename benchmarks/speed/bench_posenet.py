"""How fast posenet trains and predicts, stage by stage, on this machine.

    python benchmarks/speed/bench_posenet.py [--preset all] [--steps 12] [--refine-poses 100]

Data are simulated bunnies of the resolution that each preset is made for: 320 x 240 (`simgen build --preset demo`), and
640 x 480 for `paper` (`--preset default`), whose steps take seconds on a CPU, so that it takes fewer. Times are medians
over steps after a warm-up of two, by the wall clock, and beside them the CPU's (of all threads together): on a machine
that does other work the first says little. `--json FILE` keeps the figures.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.optim import Optimizer

from evalkit.geometry.camera import Camera
from posenet.config import PRESETS, preset
from posenet.device import supports_bf16
from posenet.network import losses
from posenet.network.pose_network import PoseNetwork
from posenet.network.targets import Batch
from posenet.optimizers.make import build_optimizers
from posenet.refinement.refiner import Refiner
from posenet.training.dataset import Frames

WARM_UP = 2
SIMGEN_PRESET = {"paper": "paper", "small": "demo", "debug": "demo"}
MOST_PAPER_STEPS = 3
STAGES = ("load", "forward", "scoring", "backward", "optimizer")


class Seconds(NamedTuple):
    """By the wall clock, and of all CPU cores together."""

    wall: float
    cpu: float

    def times(self, factor: float) -> Seconds:
        return Seconds(self.wall * factor, self.cpu * factor)

    def beyond(self, other: Seconds) -> Seconds:
        return Seconds(max(self.wall - other.wall, 0.0), max(self.cpu - other.cpu, 0.0))

    def __str__(self) -> str:
        return f"{self.wall * 1e3:8.1f} ms ({self.cpu * 1e3:.1f} CPU)"


Rows = dict[str, list[Seconds]]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--preset", choices=[*PRESETS, "all"], default="all")
    arguments.add_argument("--steps", type=int, default=12)
    arguments.add_argument("--refine-poses", type=int, default=100, help="poses of an image that are refined")
    arguments.add_argument("--json", type=Path, help="write the figures there too")
    options = arguments.parse_args()
    names = list(PRESETS) if options.preset == "all" else [options.preset]
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in sorted(names, key=lambda name: name == "paper"):  # the slow one last
            steps = min(options.steps, MOST_PAPER_STEPS) if name == "paper" else options.steps
            frames = Frames(_build(Path(folder), SIMGEN_PRESET[name]))
            found[name] = bench(name, frames, steps, options.refine_poses)
    if options.json:
        options.json.write_text(
            json.dumps({name: _plain(figures) for name, figures in found.items()}, indent=1) + "\n", encoding="utf-8"
        )


def bench(name: str, frames: Frames, steps: int, refined: int) -> dict[str, Seconds]:
    """All figures of one preset: seconds by stage, an image."""
    torch.manual_seed(0)
    network = PoseNetwork(preset(name), frames.model, (0.3, 0.6), frames.camera).in_fast_layout()
    network.bf16 = supports_bf16(torch.device("cpu"))
    layers = "bf16" if network.bf16 else "float32"
    count = sum(parameter.numel() for parameter in network.parameters()) / 1e6
    print(f"{name}: {count:.1f} M parameters, {torch.get_num_threads()} threads, {layers} layers, {steps} steps")
    return bench_training(network, frames, steps) | bench_prediction(network, frames, steps, refined)


def bench_training(network: PoseNetwork, frames: Frames, steps: int) -> dict[str, Seconds]:
    """Loading, forward, the scores' part of it, backward, and the optimizer's step of one batch.

    The scores train every `scoring_every` steps, and that share of their time counts.
    """
    train = network.config.train
    main, scoring = build_optimizers(network, train)
    optimizers = [main, *([scoring] if scoring else [])]
    rows: Rows = {}
    network.train()
    for step in range(steps + WARM_UP):
        numbers = np.arange(step * train.batch_images, (step + 1) * train.batch_images) % len(frames.dataset)
        batch: Batch = _timed(rows, "load", frames.batch, numbers)
        loss = _timed(rows, "forward", _loss, network, batch)
        _timed(rows, "backward", loss.backward)
        _timed(rows, "scoring", _scoring, network, batch)
        _timed(rows, "optimizer", _step, optimizers)
    spent = {name: _median(rows[name]).times(1 / train.batch_images) for name in STAGES}
    # What is timed as scoring runs the multi-task part once more; what it adds is the difference.
    spent["scoring"] = spent["scoring"].beyond(spent["forward"]).times(1 / train.scoring_every)
    whole = Seconds(sum(part.wall for part in spent.values()), sum(part.cpu for part in spent.values()))
    print(f"  training on {_size(frames.camera)}: {1 / whole.wall:.1f} images/s, batches of {train.batch_images}")
    for name, seconds in spent.items():
        print(f"    {name:<14}{seconds} an image {seconds.wall / whole.wall:6.0%}")
    return {"training": whole, **spent}


def _step(optimizers: list[Optimizer]) -> None:
    for optimizer in optimizers:
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)


def bench_prediction(network: PoseNetwork, frames: Frames, steps: int, refined: int) -> dict[str, Seconds]:
    """Network and refinement, one image at a time, as `posenet predict` and a robot have it."""
    network.eval()
    refiner = Refiner(frames.model)
    rows: Rows = {}
    for step in range(steps + WARM_UP):
        view = frames.dataset[step % len(frames.dataset)]
        batch = frames.batch(np.array([step % len(frames.dataset)]))
        _timed(rows, "trunk", network.encode, batch.depth, batch.intrinsics)
        _timed(rows, "network", network.predict, batch.depth, batch.intrinsics)
        truth = np.resize(view.instances.cam_from_obj, (refined, 4, 4))
        _timed(rows, "refinement", refiner.refine, view.depth, view.camera, truth, np.ones(refined))
    trunk, whole, refinement = (_median(rows[name]) for name in ("trunk", "network", "refinement"))
    refined_too = Seconds(whole.wall + refinement.wall, whole.cpu + refinement.cpu)
    print(f"  prediction on {_size(frames.camera)}, one image at a time")
    print(f"    {'trunk':<14}{trunk}")
    print(f"    {'the rest':<14}{whole.beyond(trunk)}: detector, heads, hypotheses, registration")
    print(f"    {'unrefined':<14}{whole}")
    print(f"    {'refined':<14}{refined_too}: and the refinement of {refined} poses")
    return {"predict": whole, "predict_trunk": trunk, "refine": refinement}


@torch.no_grad()
def _scoring(network: PoseNetwork, batch: Batch) -> None:
    network(batch, network.config.train.scoring_images)


def _loss(network: PoseNetwork, batch: Batch) -> torch.Tensor:
    return losses.total(network(batch), network.config.loss)


def _timed(rows: Rows, name: str, work: Callable[..., Any], *arguments: Any) -> Any:
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(*arguments)
    rows.setdefault(name, []).append(Seconds(time.perf_counter() - wall, time.process_time() - cpu))
    return result


def _median(times: list[Seconds]) -> Seconds:
    wall, cpu = zip(*times[WARM_UP:], strict=True)
    return Seconds(statistics.median(wall), statistics.median(cpu))


def _plain(figures: dict[str, Seconds]) -> dict[str, dict[str, float]]:
    return {name: seconds._asdict() for name, seconds in figures.items()}


def _size(camera: Camera) -> str:
    return f"{camera.width} x {camera.height}"


def _build(folder: Path, simgen_preset: str) -> Path:
    out = folder / simgen_preset
    if not out.exists():
        simgen = Path(sys.executable).with_name("simgen")
        words = [str(simgen), "build", "--object", "bunny", "--preset", simgen_preset, "--scenes", "4", "-o", str(out)]
        subprocess.run(words, check=True, capture_output=True)
    return out


if __name__ == "__main__":
    main()
