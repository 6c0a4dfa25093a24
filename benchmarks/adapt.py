"""How much of the gap to another sensor `posenet adapt` closes, with 30 images that nobody labeled.

    python benchmarks/adapt.py --model runs/ideal --like runs/stereo     # the second: trained with the right sensor

--model was trained on ideal depth. It is adapted on 30 images of --sensor, whose labels are never read, and scored on
80 others; the gap is that between its AP there and that of --like.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from commands import run as run_command

FRAMES = ("--scenes", 15, "--views", 2, "--seed", 2000)
TEST = ("--scenes", 40, "--views", 2, "--seed", 1000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--like", type=Path, help="a network trained with the right sensor")
    parser.add_argument("--object", default="bunny")
    parser.add_argument("--sensor", default="stereo")
    parser.add_argument("--minutes", type=float, default=5)
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/adapt"))
    options = parser.parse_args()
    frames, test, adapted = options.out / "frames", options.out / "test", options.out / "adapted.pt"
    for folder, size in ((frames, FRAMES), (test, TEST)):
        run_command("simgen", "build", "--object", options.object, "--sensor", options.sensor, *size, "-o", folder)
    run_command("evalkit", "gt", test, "-o", options.out / "gt.json")
    run_command("posenet", "adapt", options.model, frames, "--minutes", options.minutes, "-o", adapted)
    models = {"before": options.model, "adapted": adapted}
    models |= {"trained with the right sensor": options.like} if options.like else {}
    scores = {name: score(model, test, options.out) for name, model in models.items()}
    print("\n| network alone | AP |\n|---|---|")
    print("\n".join(f"| {name} | {ap:.3f} |" for name, ap in scores.items()))
    if options.like:
        before, after, right = scores.values()
        print(f"\nGap closed: {(after - before) / max(right - before, 1e-9):.0%}")


def score(model: Path, test: Path, out: Path) -> float:
    """AP of a network alone."""
    preds, figures = out / "preds.json", out / "ap.json"
    run_command("posenet", "predict", model, test, "-o", preds)
    run_command("evalkit", "ap", preds, out / "gt.json", "--json", figures)
    return float(json.loads(figures.read_text(encoding="utf-8"))["ap"])


if __name__ == "__main__":
    main()
