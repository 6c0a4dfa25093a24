"""How prediction fares on a busy machine: time an image, with free cores and beside other programs, before and after.

    python benchmarks/speed/busy.py [MODEL] [--images 30] [--busy 1] [--threads 2]

"Before" is OpenMP's own way of waiting (threads spin for milliseconds), "after" posenet's (see `posenet.threads`); a
third row has one thread, which waits for nobody. The rows are run in turn, twice, and the better median counts.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MODEL = Path(__file__).parents[2] / "data" / "models" / "bunny-stereo.pt"
ROUNDS = 2
WARM_UP = 3
SPIN = "while True: pass"


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("model", type=Path, nargs="?", default=MODEL)
    arguments.add_argument("--images", type=int, default=30, help="predicted in each run")
    arguments.add_argument("--busy", type=int, default=1, help="other programs that use a core")
    arguments.add_argument("--threads", type=int, default=2, help="of prediction")
    arguments.add_argument("--refine", action="store_true")
    arguments.add_argument("--shards", type=Path, help="images to predict on  [default: bunnies, built for it]")
    arguments.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = arguments.parse_args()
    if options.worker:
        print(median_seconds(options))
        return
    with tempfile.TemporaryDirectory() as folder:
        options.shards = options.shards or built(Path(folder) / "shards")
        for line in table(options):
            print(line, flush=True)


def median_seconds(options: argparse.Namespace) -> float:
    """Of one image, one at a time, as a robot has it."""
    from evalkit.datasets.shard_folder import ShardDataset
    from posenet.prediction.predictor import Predictor

    predictor, view = Predictor.load(options.model, "cpu", options.refine), ShardDataset(options.shards)[0]
    seconds = [predictor.predict(view.depth, view.camera).time_s for _ in range(options.images + WARM_UP)]
    return statistics.median(seconds[WARM_UP:])


def table(options: argparse.Namespace) -> Iterator[str]:
    """The rows as Markdown."""
    ways = {
        "before: threads spin": {"GOMP_SPINCOUNT": "300000", "KMP_BLOCKTIME": "200"},
        "after: threads wait briefly": {},
        "one thread": {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    }
    found: dict[tuple[str, bool], list[float]] = {}
    for _ in range(ROUNDS):
        for name, environment in ways.items():
            for busy in (False, True):
                with others(options.busy if busy else 0):
                    found.setdefault((name, busy), []).append(measured(options, environment))
    yield f"| {options.threads} threads | free | beside {options.busy} busy | busy / free |"
    yield "|---|---|---|---|"
    for name in ways:
        free, beside = (min(found[name, state]) * 1e3 for state in (False, True))
        yield f"| {name} | {free:.0f} ms | {beside:.0f} ms | {beside / free:.1f} |"


def measured(options: argparse.Namespace, environment: dict[str, str]) -> float:
    """Seconds an image, by a fresh process: OpenMP reads its variables once."""
    words = [sys.executable, __file__, str(options.model), "--worker", "--shards", str(options.shards)]
    words += ["--images", str(options.images)] + (["--refine"] if options.refine else [])
    threads = {name: str(options.threads) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    clean = {name: value for name, value in os.environ.items() if name not in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")}
    done = subprocess.run(words, env=clean | threads | environment, check=True, capture_output=True, text=True)
    return float(done.stdout)


@contextmanager
def others(count: int) -> Iterator[None]:
    """So many programs that each keep a core busy."""
    running = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(count)]
    time.sleep(0.2)
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def built(out: Path) -> Path:
    simgen = Path(sys.executable).with_name("simgen")
    words = [str(simgen), "build", "--object", "bunny", "--preset", "demo", "--scenes", "1", "--views", "1"]
    subprocess.run([*words, "-o", str(out)], check=True, capture_output=True)
    return out


if __name__ == "__main__":
    main()
