"""The whole pipeline on the built-in bunny, as a user types it: mesh, piles, training, poses, AP and pictures.

Training gets what is left of a quarter of an hour. Stopped and started again, it goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from commands import run as run_command

BUDGET_MINUTES = 14.0
AFTER_TRAINING_MINUTES = 1.2  # prediction, scoring and pictures
TRAIN_SCENES = 400  # two passes over them fill the time
TEST_SEED = 1000


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--object", default="bunny", help="mesh file or built-in object")
    arguments.add_argument("--out", type=Path, default=Path("demo"))
    arguments.add_argument("--budget", type=float, default=BUDGET_MINUTES, help="minutes for everything")
    options = arguments.parse_args()
    try:
        return demo(options.object, options.out, options.budget)
    except subprocess.CalledProcessError as error:
        print(f"\nStopped in: {' '.join(map(str, error.cmd))}", file=sys.stderr)
        return int(error.returncode) or 1
    except KeyboardInterrupt:
        print("\nInterrupted; `make demo` goes on where it was.", file=sys.stderr)
        return 130


def demo(mesh: str, out: Path, budget: float) -> int:
    started = time.monotonic()
    train, test, run = out / "train", out / "test", out / "run"
    _run("1/6 training scenes", "simgen", "build", "--object", mesh, "--preset", "demo",
         "--scenes", TRAIN_SCENES, "-o", train)  # fmt: skip
    _run("2/6 test scenes, of another seed", "simgen", "build", "--object", mesh, "--preset", "demo",
         "--scenes", 40, "--views", 2, "--seed", TEST_SEED, "-o", test)  # fmt: skip
    spent = (time.monotonic() - started) / 60
    minutes = _planned_minutes(run) or round(max(budget - spent - AFTER_TRAINING_MINUTES, 1.0), 2)
    _run(f"3/6 training for {minutes:g} minutes", "posenet", "fit", train, "--preset", "small", "--minutes", minutes,
         "-o", run)  # fmt: skip
    _run("4/6 poses on the test scenes: the network alone, then fitted to the image", "posenet", "predict", run, test,
         "-o", out / "preds_alone.json")  # fmt: skip
    _run("", "posenet", "predict", run, test, "--refine", "-o", out / "preds.json")
    _run("5/6 score", "evalkit", "gt", test, "-o", out / "gt.json")
    for name in ("_alone", ""):
        _run("", "evalkit", "ap", out / f"preds{name}.json", out / "gt.json", "--json", out / f"ap{name}.json",
             "--plot", out / f"pr{name}.png")  # fmt: skip
    _run("6/6 picture", "evalkit", "picture", out / "preds.json", out / "gt.json", "--shards", test,
         "-o", out / "picture.png")  # fmt: skip
    _summary(out, (time.monotonic() - started) / 60, minutes)
    return 0


def _summary(out: Path, took: float, minutes: float) -> None:
    alone, refined = (json.loads((out / f"ap{name}.json").read_text()) for name in ("_alone", ""))
    print(f"\nAP {alone['ap']:.3f} by the network alone, {refined['ap']:.3f} refined", end="")
    print(f", on {refined['counts']['images']} images of scenes never trained on.")
    print(f"Protocol: {refined['protocol']}")
    print(f"Pictures: {out / 'picture.png'}, {out / 'pr.png'}")
    print(f"Model:    {out / 'run' / 'model.pt'} (try: posenet info {out / 'run'})")
    print(f"Took {took:.1f} minutes, {minutes:g} of them training.")


def _planned_minutes(run: Path) -> float | None:
    """The training minutes of a demo that was stopped, so that it resumes."""
    file = run / "run.json"
    return float(json.loads(file.read_text())["minutes"]) if file.exists() else None


def _run(title: str, command: str, *arguments: object) -> None:
    """Run one of our commands as a user would, and show it."""
    if title:
        print(f"\n=== {title}")
    run_command(command, *arguments)


if __name__ == "__main__":
    sys.exit(main())
