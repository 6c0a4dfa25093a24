"""The commands that README opens with, as typed, from an empty folder: minutes of each, and AP on unseen scenes.

    python benchmarks/as_typed.py                       # bunny, everything by default: about an hour on 2 CPU cores
    python benchmarks/as_typed.py --object part.stl --sensors ideal

Nothing is given that a user would not give. The test scenes (another seed) are seen by an ideal camera and by those of
--sensors, none of which trained. --scenes and --minutes make it shorter (`make demo` is this with fewer scenes).
Stopped and started again it goes on where it was; then the minutes of what was finished before are not its minutes.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from commands import run as run_command

TEST_SCENES, TEST_VIEWS, TEST_SEED = 40, 2, 1000
SENSORS = ("ideal", "stereo", "kinect")
VISIBILITIES = (0.5, 0.3)
RESAMPLES = 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="bunny", help="mesh file or built-in object")
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/as-typed"))
    parser.add_argument("--sensors", nargs="*", default=SENSORS, choices=SENSORS, help="of the test images")
    parser.add_argument("--scenes", type=int, help="to train on; left to simgen if not given")
    parser.add_argument("--minutes", type=float, help="of training; left to posenet if not given")
    options = parser.parse_args()
    pipeline = Pipeline(options.object, options.out)
    pipeline.build_training_scenes(options.scenes)
    pipeline.fit(options.minutes)
    rows = [row for sensor in options.sensors for row in pipeline.score(sensor)]
    print("\n" + pipeline.minutes_table())
    print("\n" + table(["test images", "visible (geometric)", "AP alone", "95 %", "AP refined", "95 %"], rows))


@dataclass
class Pipeline:
    """The way from a mesh to a score, in one folder."""

    mesh: str  # its file, or the name of a built-in object
    out: Path
    minutes: dict[str, float] = field(default_factory=dict)  # spent, by step

    @property
    def model(self) -> Path:
        return self.out / "run"

    def build_training_scenes(self, scenes: int | None = None) -> None:
        self._run("build", "simgen", "build", "--object", self.mesh, *_given("--scenes", scenes),
                  "-o", self.out / "shards")  # fmt: skip

    def fit(self, minutes: float | None = None) -> None:
        self._run("fit", "posenet", "fit", self.out / "shards", *_given("--minutes", minutes), "-o", self.model)

    def build_test_scenes(self, sensor: str = "ideal") -> Path:
        """Scenes of another seed, seen by a camera of that kind."""
        test = self.out / f"test-{sensor}"
        self._run("test scenes", "simgen", "build", "--object", self.mesh, "--scenes", TEST_SCENES,
                  "--views", TEST_VIEWS, "--seed", TEST_SEED, "--sensor", sensor, "-o", test)  # fmt: skip
        self._run("test scenes", "evalkit", "gt", test, "-o", self.out / f"gt-{sensor}.json")
        return test

    def predict(self, sensor: str = "ideal") -> dict[str, Path]:
        """Predictions on the test scenes by the network alone, and refined."""
        test, found = self.build_test_scenes(sensor), {}
        for kind, refine in (("alone", []), ("refined", ["--refine"])):
            found[kind] = self.out / f"preds-{sensor}-{kind}.json"
            self._run(f"predict, {kind}", "posenet", "predict", self.model, test, *refine, "-o", found[kind])
        return found

    def score(self, sensor: str = "ideal") -> list[list[str]]:
        """Table rows: one for each visibility from which instances count."""
        found = self.predict(sensor)
        rows = []
        for visibility in VISIBILITIES:
            cells = [cell for file in found.values() for cell in _cells(self.ap(file, sensor, visibility))]
            rows.append([sensor, f">= {visibility:.0%}", *cells])
        return rows

    def ap(self, predictions: Path, sensor: str = "ideal", visibility: float = 0.5, *options: object) -> dict[str, Any]:
        """The figures of `evalkit ap`, as it writes them."""
        figures = predictions.with_name(f"{predictions.stem}-ap-{visibility:g}.json")
        self._run("score", "evalkit", "ap", predictions, self.out / f"gt-{sensor}.json", "--min-visibility", visibility,
                  "--bootstrap", RESAMPLES, "--json", figures, *options)  # fmt: skip
        return dict(json.loads(figures.read_text()))

    def minutes_table(self) -> str:
        total = sum(self.minutes.values())
        return table(["step", "minutes"], [[k, f"{v:.1f}"] for k, v in [*self.minutes.items(), ("together", total)]])

    def _run(self, step: str, command: str, *arguments: object) -> None:
        started = time.monotonic()
        run_command(command, *arguments)
        self.minutes[step] = self.minutes.get(step, 0.0) + (time.monotonic() - started) / 60


def table(titles: list[str], rows: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in [titles, ["---"] * len(titles), *rows])


def _given(option: str, value: float | None) -> list[object]:
    return [] if value is None else [option, value]


def _cells(figures: dict[str, Any]) -> list[str]:
    low, high = figures["bootstrap"]["ap"]
    return [f"{figures['ap']:.3f}", f"{low:.3f} to {high:.3f}"]


if __name__ == "__main__":
    main()
