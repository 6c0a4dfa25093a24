"""How fast posenet trains and predicts, stage by stage, on this machine.

    python benchmarks/bench_posenet.py [--preset small] [--steps 12]

Data are simulated bunnies (`simgen build --preset demo --scenes 4`). Times are medians over steps after a warm-up.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from posenet import losses
from posenet.config import PRESETS, preset
from posenet.dataset import Frames
from posenet.device import supports_bf16
from posenet.network import PoseNetwork
from posenet.refine import Refiner
from posenet.targets import Batch


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--preset", choices=list(PRESETS), default="small")
    arguments.add_argument("--steps", type=int, default=12)
    options = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        frames = Frames(_build(Path(folder) / "shards"))
        torch.manual_seed(0)
        config = preset(options.preset)
        network = PoseNetwork(config, frames.model, (0.3, 0.6), frames.camera).in_fast_layout()
        network.bf16 = supports_bf16(torch.device("cpu"))
        print(f"{options.preset}: {torch.get_num_threads()} threads, {'bf16' if network.bf16 else 'float32'} layers")
        bench_training(network, frames, options.steps)
        bench_prediction(network, frames, options.steps)


def bench_training(network: PoseNetwork, frames: Frames, steps: int) -> None:
    """Loading, forward, backward, and the optimiser's step of one batch."""
    size = network.config.train.batch_images
    optimizer = torch.optim.AdamW(network.parameters(), 1e-3)
    rows: dict[str, list[float]] = {}
    network.train()
    for step in range(steps + 2):
        numbers = np.arange(step * size, (step + 1) * size) % len(frames.dataset)
        batch: Batch = _timed(rows, "load", frames.batch, numbers)
        loss = _timed(rows, "forward", _loss, network, batch)
        _timed(rows, "backward", loss.backward)
        _timed(rows, "optimiser", optimizer.step)
        optimizer.zero_grad(set_to_none=True)
    medians = {name: statistics.median(values[2:]) for name, values in rows.items()}
    whole = sum(medians.values())
    print(f"training    {size / whole:6.1f} images/s, batches of {size}")
    for name, seconds in medians.items():
        print(f"  {name:<10}{seconds / size * 1e3:7.1f} ms an image {seconds / whole:6.0%}")


def bench_prediction(network: PoseNetwork, frames: Frames, steps: int) -> None:
    """Network and refinement, one image at a time, as `posenet predict` and a robot have it."""
    network.eval()
    refiner = Refiner(frames.model)
    rows: dict[str, list[float]] = {}
    for step in range(steps + 2):
        view = frames.dataset[step]
        batch = frames.batch(np.array([step]))
        _timed(rows, "network", network.predict, batch.depth, batch.intrinsics)
        truth = np.resize(view.instances.cam_from_obj, (100, 4, 4))
        _timed(rows, "refine 100", refiner.refine, view.depth, view.camera, truth, np.ones(100))
    print("prediction, one image of 320 x 240")
    for name, values in rows.items():
        print(f"  {name:<10}{statistics.median(values[2:]) * 1e3:7.1f} ms")


def _loss(network: PoseNetwork, batch: Batch) -> torch.Tensor:
    return losses.total(network(batch), network.config.loss)


def _timed(rows: dict[str, list[float]], name: str, work: Callable[..., Any], *arguments: Any) -> Any:
    started = time.perf_counter()
    result = work(*arguments)
    rows.setdefault(name, []).append(time.perf_counter() - started)
    return result


def _build(out: Path) -> Path:
    simgen = Path(sys.executable).with_name("simgen")
    words = [str(simgen), "build", "--object", "bunny", "--preset", "demo", "--scenes", "4", "-o", str(out)]
    subprocess.run(words, check=True, capture_output=True)
    return out


if __name__ == "__main__":
    main()
