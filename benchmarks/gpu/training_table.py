"""The table at the end of gpu_paper.sh: AP, images a second, minutes, milliseconds an image, share of the matrix peak.

    python benchmarks/gpu/training_table.py OUT [--device cuda]

The peak is what this machine reaches in one large matrix product of the training's precision, not a data sheet's.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from posenet.device import choose_device, supports_bf16
from posenet.models.model_file import load_model
from posenet.network import losses
from posenet.network.pose_network import PoseNetwork
from posenet.training.dataset import Frames

SIDES = {"cuda": 8192, "cpu": 2048}  # of the matrices


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder that gpu_paper.sh filled")
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    device = choose_device(options.device)
    trained = load_model(options.out / "run", device)
    last = json.loads((options.out / "run" / "losses.jsonl").read_text().splitlines()[-1])
    rate = last["images"] / (60 * last["minutes"])
    work = flops_of_an_image(trained.network, Frames(options.out / "train"), device)
    peak = matrix_peak(device)
    rows = {
        "AP alone": f"{ap(options.out / 'alone-ap.json'):.3f}",
        "AP refined": f"{ap(options.out / 'refined-ap.json'):.3f}",
        "images trained on": f"{last['images']:.0f}",
        "minutes of training": f"{last['minutes']:.1f}",
        "images/s": f"{rate:.1f}",
        "ms an image, alone": f"{milliseconds(options.out / 'alone.json'):.1f}",
        "ms an image, refined": f"{milliseconds(options.out / 'refined.json'):.1f}",
        "GFLOP an image, forward and backward": f"{work / 1e9:.1f}",
        "share of the matrix peak": f"{rate * work / peak:.1%} of {peak / 1e12:.2f} TFLOP/s",
    }
    print(f"\n{trained.network.config.preset} on {device}; {protocol(options.out / 'alone-ap.json')}")
    for name, value in rows.items():
        print(f"  {name:<38}{value}")


def flops_of_an_image(network: PoseNetwork, frames: Frames, device: torch.device) -> float:
    """Floating-point operations of a training step's layers, an image."""
    count = min(network.config.train.batch_images, len(frames.dataset))
    batch = frames.batch(np.arange(count)).to(device)
    network.train()
    with FlopCounterMode(display=False) as counter:
        losses.total(network(batch), network.config.loss).backward()
    return float(counter.get_total_flops()) / count


def matrix_peak(device: torch.device, repeats: int = 10) -> float:
    """Operations a second of the best of some large matrix products."""
    side = SIDES.get(device.type, 2048)
    kind = torch.bfloat16 if supports_bf16(device) else torch.float32
    a, b = (torch.randn(side, side, device=device, dtype=kind) for _ in range(2))
    best = np.inf
    for _ in range(repeats):
        _wait(device)
        started = time.perf_counter()
        torch.mm(a, b)
        _wait(device)
        best = min(best, time.perf_counter() - started)
    return float(2 * side**3 / best)


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize()


def ap(figures: Path) -> float:
    return float(json.loads(figures.read_text())["ap"])


def protocol(figures: Path) -> str:
    document: dict[str, Any] = json.loads(figures.read_text())
    return f"{document['counts']['images']} images; {document['protocol']}"


def milliseconds(predictions: Path) -> float:
    """Median time an image."""
    times = [image["time_s"] for image in json.loads(predictions.read_text())["images"]]
    return 1e3 * float(np.median(times))


if __name__ == "__main__":
    main()
