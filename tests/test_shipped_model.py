"""The model in data/models finds bunnies in heaps that it never saw, and is small enough to travel."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

MODEL = Path(__file__).parents[1] / "data" / "models" / "bunny-stereo.pt"
LEAST_AP = 0.9  # of 0.986 on many more images


def test_the_shipped_model_finds_bunnies_in_noisy_heaps(
    tmp_path: Path, run_command: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    heaps, found, truth, result = (tmp_path / name for name in ("heaps", "preds.json", "gt.json", "ap.json"))
    for words in (
        ("simgen", "build", "--object", "bunny", "--preset", "demo", "--sensor", "stereo", "--scenes", 2, "--views", 2,
         "--seed", 4242, "-o", heaps),
        ("posenet", "predict", MODEL, heaps, "--refine", "-o", found),
        ("evalkit", "gt", heaps, "-o", truth),
        ("evalkit", "ap", found, truth, "--json", result),
    ):  # fmt: skip
        done = run_command(*words)
        assert done.returncode == 0, done.stderr
    assert json.loads(result.read_text())["ap"] > LEAST_AP


def test_the_shipped_model_travels_light() -> None:
    assert MODEL.stat().st_size < 10e6
