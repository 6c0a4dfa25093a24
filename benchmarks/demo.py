"""The whole pipeline on the built-in bunny, as a user types it, with fewer scenes: as_typed.py in a quarter of an hour.

Training gets what is left of it, on a slow or busy machine so much that the network still learns. Stopped and started
again, it goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from as_typed import Pipeline
from commands import run as run_command

BUDGET_MINUTES = 14.0
AFTER_TRAINING_MINUTES = 1.2  # prediction, scoring and pictures
LEAST_TRAINING_MINUTES = 8.0  # less leaves a network that finds nothing, however slow the machine was until then
TRAIN_SCENES = 400  # two passes over them fill the time


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--object", default="bunny", help="mesh file or built-in object")
    arguments.add_argument("-o", "--output", dest="out", type=Path, default=Path("demo"))
    arguments.add_argument("--minutes", type=float, help="of training (what is left of a quarter of an hour)")
    options = arguments.parse_args()
    try:
        return demo(options.object, options.out, options.minutes)
    except subprocess.CalledProcessError as error:
        print(f"\nStopped in: {' '.join(map(str, error.cmd))}", file=sys.stderr)
        return int(error.returncode) or 1
    except KeyboardInterrupt:
        print("\nInterrupted; `make demo` goes on where it was.", file=sys.stderr)
        return 130


def demo(mesh: str, out: Path, minutes: float | None = None) -> int:
    started = time.monotonic()
    pipeline = Pipeline(mesh, out)
    print("=== 1/5 training scenes")
    pipeline.build_training_scenes(TRAIN_SCENES)
    print("\n=== 2/5 test scenes, of another seed")
    pipeline.build_test_scenes()
    spent = (time.monotonic() - started) / 60
    left = round(max(BUDGET_MINUTES - spent - AFTER_TRAINING_MINUTES, LEAST_TRAINING_MINUTES), 2)
    minutes = _planned_minutes(pipeline.model) or minutes or left
    print(f"\n=== 3/5 training for {minutes:g} minutes")
    pipeline.fit(minutes)
    print("\n=== 4/5 poses on the test scenes: the network alone, then fitted to the image")
    found = pipeline.predict()
    print("\n=== 5/5 score and picture")
    plots = {"alone": out / "pr_alone.png", "refined": out / "pr.png"}
    figures = {kind: pipeline.ap(file, "ideal", 0.5, "--plot", plots[kind]) for kind, file in found.items()}
    run_command("evalkit", "picture", found["refined"], out / "gt-ideal.json", "--shards", out / "test-ideal",
                "-o", out / "picture.png")  # fmt: skip
    alone, refined = figures["alone"], figures["refined"]
    print(f"\nAP {alone['ap']:.3f} by the network alone, {refined['ap']:.3f} refined", end="")
    print(f", on {refined['counts']['images']} images of scenes never trained on.")
    print(f"Protocol: {refined['protocol']}")
    print(f"Pictures: {out / 'picture.png'}, {plots['refined']}")
    print(f"Model:    {pipeline.model / 'model.pt'} (try: posenet info {pipeline.model})")
    print(f"Took {(time.monotonic() - started) / 60:.1f} minutes, {minutes:g} of them training.")
    return 0


def _planned_minutes(run: Path) -> float | None:
    """The training minutes of a demo that was stopped, so that it resumes."""
    file = run / "run.json"
    return float(json.loads(file.read_text())["minutes"]) if file.exists() else None


if __name__ == "__main__":
    sys.exit(main())
