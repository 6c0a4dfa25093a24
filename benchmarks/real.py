"""A model on real depth images, whose truth nobody knows: verified instances, precision, contradicted poses, pictures.

    python benchmarks/real.py FOLDER --model runs/part-small --mesh part.stl --camera camera.json --depth-unit 0.001
    python benchmarks/real.py FOLDER --mesh part.stl --camera camera.json --depth-unit 0.001 --minutes 15

FOLDER holds the depth images. Without --model, one is first trained on simulated stereo images of the mesh as typed:
`simgen build --object MESH --preset demo --sensor stereo`, `posenet fit`. The network alone and refined poses are then
held against the images by `evalkit verify`, which ray traces the part at each pose; look at the sheets.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from commands import run as run_command


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of depth images, with anything that `posenet predict` reads")
    parser.add_argument("--mesh", type=Path, required=True)
    parser.add_argument("--camera", type=Path, help="of the images; a camera.json among them is taken by itself")
    parser.add_argument("--depth-unit", help="meters a step of the images' values")
    parser.add_argument("--units", help="of the mesh")
    parser.add_argument("--model", type=Path, help="to score, in place of one trained here")
    parser.add_argument("--minutes", type=float, default=15, help="of training, without --model")
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/real"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    model = options.model or train(options.mesh, options.units, options.minutes, options.out)
    reading = [*given("--camera", options.camera), *given("--depth-unit", options.depth_unit)]
    rows = []
    for kind, refine in (("alone", []), ("refined", ["--refine"])):
        preds, verdicts = options.out / f"preds-{kind}.json", options.out / f"verdicts-{kind}.json"
        run_command("posenet", "predict", model, options.folder, *reading, *refine, "-o", preds)
        part = ["--mesh", options.mesh, *given("--units", options.units)]
        sheet = options.out / f"sheet-{kind}.png"
        run_command("evalkit", "verify", preds, options.folder, *part, *reading, "--json", verdicts, "--picture", sheet)
        rows.append(row(kind, json.loads(verdicts.read_text(encoding="utf-8"))))
    print("\n" + "\n".join([HEAD, "|---" * HEAD.count(" | ") + "|---|", *rows]))


HEAD = "| poses | images | scored >= 0.5 | verified instances | duplicates | contradicted | undecided | precision |"


def row(kind: str, found: dict[str, float]) -> str:
    counts = [found[key] for key in ("images", "poses", "verified", "duplicates", "contradicted", "undecided")]
    return f"| {kind} | " + " | ".join(map(str, counts)) + f" | {found['precision']:.3f} |"


def train(mesh: Path, units: str | None, minutes: float, out: Path) -> Path:
    """A model of the mesh, trained on simulated stereo images."""
    shards, run = out / "shards", out / "run"
    run_command("simgen", "build", "--object", mesh, *given("--units", units), "--preset", "demo", "--sensor", "stereo",
                "-o", shards)  # fmt: skip
    run_command("posenet", "fit", shards, "--minutes", minutes, "-o", run)
    return run


def given(option: str, value: object) -> list[object]:
    return [] if value is None else [option, value]


if __name__ == "__main__":
    main()
