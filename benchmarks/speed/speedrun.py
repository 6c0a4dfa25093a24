"""What two builds of this project make of the same minutes: AP of the network alone against minutes of training.

    python benchmarks/speed/speedrun.py ../before/.venv/bin          # that build against the one that runs this
    python benchmarks/speed/speedrun.py ../before/.venv/bin --minutes 5 10 20 45 --until 0.95

The builds train in turn on the same shards and are scored on the same images of other scenes by this build's evalkit.
The older one writes the shards, for a newer one reads them. Each point of the curve is a training of its own, with the
schedule that ends then: in the middle of a longer one AP says little. Stopped and started again it goes on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

OWN = Path(sys.executable).parent
TEST_SCENES, TEST_VIEWS, TEST_SEED = 40, 2, 1000
VISIBILITY = 0.5

Curve = list[tuple[float, float]]  # minutes, AP


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="folder with the commands of the older build")
    parser.add_argument("after", type=Path, nargs="?", default=OWN, help="of the newer one  [default: this build]")
    parser.add_argument("--minutes", type=float, nargs="+", default=[5.0, 10.0, 20.0, 45.0], help="of each training")
    parser.add_argument("--until", type=float, default=0.95, help="the AP whose minutes are compared")
    parser.add_argument("--object", default="bunny", help="mesh file or built-in object")
    parser.add_argument("--sensor", default="stereo")
    parser.add_argument("--scenes", type=int, default=320, help="to train on")
    parser.add_argument("--test-scenes", type=int, default=TEST_SCENES)
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/speedrun"))
    options = parser.parse_args()
    race = Race(options.out, {"before": options.before, "after": options.after})
    race.build(options.object, options.sensor, options.scenes, options.test_scenes)
    curves: dict[str, Curve] = {name: [] for name in race.builds}
    for minutes in sorted(options.minutes):
        for name, curve in curves.items():
            curve.append((minutes, race.ap(name, minutes)))
    print("\n" + "\n".join(table(curves, options.until)))


@dataclass(frozen=True)
class Race:
    """Two builds, by name the folders of their commands, and what they share: shards and test images in `out`."""

    out: Path
    builds: dict[str, Path]

    def build(self, mesh: str, sensor: str, scenes: int, test_scenes: int) -> None:
        common = ["--object", mesh, "--preset", "demo", "--sensor", sensor]
        self._run("before", "simgen", "build", *common, "--scenes", scenes, "-o", self.out / "shards")
        self._run("before", "simgen", "build", *common, "--scenes", test_scenes, "--views", TEST_VIEWS,
                  "--seed", TEST_SEED, "-o", self.out / "test")  # fmt: skip
        self._run("after", "evalkit", "gt", self.out / "test", "-o", self.out / "gt.json")

    def ap(self, name: str, minutes: float) -> float:
        """AP alone of that build after so many minutes of training."""
        run = self.out / f"{name}-{minutes:g}"
        found, figures = run.with_suffix(".preds.json"), run.with_suffix(".ap.json")
        if not figures.exists():
            self._run(name, "posenet", "fit", self.out / "shards", "--minutes", minutes, "-o", run)
            self._run(name, "posenet", "predict", run, self.out / "test", "-o", found)
            self._run("after", "evalkit", "ap", found, self.out / "gt.json", "--min-visibility", VISIBILITY,
                      "--json", figures)  # fmt: skip
        return float(json.loads(figures.read_text())["ap"])

    def _run(self, name: str, command: str, *arguments: object) -> None:
        words = [command, *map(str, arguments)]
        print(f"{name}$ {' '.join(words)}", flush=True)
        self.out.mkdir(parents=True, exist_ok=True)
        subprocess.run([str(self.builds[name] / command), *words[1:]], check=True)


def table(curves: dict[str, Curve], until: float) -> Iterator[str]:
    """The curves side by side, and when each reaches that AP."""
    names, columns = list(curves), list(curves.values())
    yield f"| minutes | {' | '.join(f'AP alone, {name}' for name in names)} |"
    yield "|---" * (len(names) + 1) + "|"
    for row in zip(*columns, strict=True):
        yield f"| {row[0][0]:g} | {' | '.join(f'{ap:.3f}' for _, ap in row)} |"
    times = [reached(curve, until) for curve in columns]
    said = ", ".join(f"{name} {'never' if t is None else f'{t:.1f}'}" for name, t in zip(names, times, strict=True))
    yield f"\nMinutes until AP {until:g}: {said}"


def reached(curve: Curve, until: float) -> float | None:
    """When a curve first reaches an AP, between its points along the line between them; None if it does not."""
    if curve and curve[0][1] >= until:
        return curve[0][0]
    for (earlier, low), (later, high) in pairwise(curve):
        if low < until <= high:
            return earlier + (until - low) / (high - low) * (later - earlier)
    return None


if __name__ == "__main__":
    main()
