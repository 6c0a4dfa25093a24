"""What the share of visibility does to a score: one model, one set of images, both shares.

    python benchmarks/visibility.py [MODEL] [--sensor stereo] [--scenes 20 --views 2]

Bunnies, 10 to 20 a bin, 320 x 240, in scenes of another seed than training's. A sensor loses depth at edges and on
steep surface, so that fewer instances are half returned than half visible by geometry, and those left out are the hard
ones. AP is Sym, Siléane protocol.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from as_typed import table
from commands import run
from evalkit.datasets.scene import SHARES

SHIPPED = Path(__file__).parents[1] / "data" / "models" / "bunny-stereo.pt"
TEST_SEED = 1000
VISIBILITIES = (0.5, 0.3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path, nargs="?", default=SHIPPED)
    parser.add_argument("--object", default="bunny", help="the one that the model knows")
    parser.add_argument("--sensor", default="stereo")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/visibility"))
    options = parser.parse_args()
    shards, truth = options.out / options.sensor, options.out / f"{options.sensor}-gt.json"
    run("simgen", "build", "--object", options.object, "--sensor", options.sensor, "--preset", "demo", "--scenes",
        options.scenes, "--views", options.views, "--seed", TEST_SEED, "-o", shards)  # fmt: skip
    run("evalkit", "gt", shards, "-o", truth)
    found = {kind: options.out / f"{options.sensor}-{kind}.json" for kind in ("alone", "refined")}
    for kind, file in found.items():
        run("posenet", "predict", options.model, shards, *(["--refine"] if kind == "refined" else []), "-o", file)
    rows = []
    for visibility in VISIBILITIES:
        for share in SHARES:
            scores = [score(file, truth, visibility, share) for file in found.values()]
            asked = str(scores[0]["counts"]["instances_to_find"])
            rows.append([options.sensor, f">= {visibility:.0%}", share, asked, *(f"{s['ap']:.3f}" for s in scores)])
    print(table(["sensor", "visible", "share", "to find", "AP alone", "AP refined"], rows))


def score(predictions: Path, truth: Path, visibility: float, share: str) -> dict[str, Any]:
    """The figures of `evalkit ap`."""
    figures = predictions.with_name(f"{predictions.stem}-{share}-{visibility:g}.json")
    run("evalkit", "ap", predictions, truth, "--min-visibility", visibility, "--visibility", share, "--json", figures)
    return dict(json.loads(figures.read_text()))


if __name__ == "__main__":
    main()
