"""Do the verdicts of `evalkit verify`, which knows no truth, agree with the truth of simulated images?

    python benchmarks/verdicts.py                      # 40 stereo images of bunnies, the shipped model
    python benchmarks/verdicts.py --test FOLDER --preds preds.json

Judged are the refined poses scored at least 0.5, and true poses (30 % visible or more, six an image) turned and moved
a little, beyond the threshold, and far. A verdict agrees where a pose is verified and within the Sym threshold of an
instance, or contradicted and not; in the last column, undecided counts as not verified.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from commands import run as run_command
from evalkit.datasets.documents import read_predictions
from evalkit.datasets.ground_truth import read_ground_truth
from evalkit.depth.sources import open_source
from evalkit.evidence.verdict import Verdict, Verifier
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym

Array = NDArray[np.float64]
SHIPPED = Path(__file__).parents[1] / "data" / "models" / "bunny-stereo.pt"
MOVED = {"moved 0 to 0.08 diameters": (0.0, 0.08), "0.12 to 0.3": (0.12, 0.3), "0.3 to 1": (0.3, 1.0)}
AN_IMAGE, SEEN, MIN_SCORE, TURN = 6, 0.3, 0.5, 2.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--test", type=Path, help="shards to judge on")
    parser.add_argument("--preds", type=Path, help="refined poses on them")
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/verdicts"))
    options = parser.parse_args()
    test, preds = options.test or options.out / "test", options.preds or options.out / "preds.json"
    if options.test is None:
        run_command("simgen", "build", "--object", "bunny", "--preset", "demo", "--sensor", "stereo", "--scenes",
                    options.images // 2, "--views", 2, "--seed", 1000, "-o", test)  # fmt: skip
    if options.preds is None:
        run_command("posenet", "predict", SHIPPED, test, "--refine", "--max-images", options.images, "-o", preds)
    print(table(judged(test, preds)))


def judged(test: Path, preds: Path) -> dict[str, list[tuple[bool, Verdict]]]:
    """Whether each pose is right, and its verdict, by kind of pose."""
    source, truth = open_source(test), {image.id: image for image in read_ground_truth(test).images}
    assert source.model is not None
    verifier, sym, rng = Verifier(source.model), Sym(source.model), np.random.default_rng(0)
    found: dict[str, list[tuple[bool, Verdict]]] = defaultdict(list)
    for image in read_predictions(preds).images:
        number, there = source.names.index(image.id), truth[image.id]
        given = {"refined": image.cam_from_obj[image.score >= MIN_SCORE]}
        visible = there.cam_from_obj[there.visibility >= SEEN]
        some = visible[rng.permutation(len(visible))[:AN_IMAGE]]
        given |= {kind: moved(some, source.model, rng, *limits) for kind, limits in MOVED.items()}
        for kind, several in given.items():
            for pose, part in zip(
                several, verifier.examine(source.depth(number), source.cameras[number], several), strict=True
            ):
                off = sym(np.repeat(pose[None], len(there.visibility), 0), there.cam_from_obj).min()
                found[kind].append((bool(off <= source.model.threshold), part.verdict))
    return found


def moved(truth: Array, model: ObjectModel, rng: np.random.Generator, low: float, high: float) -> Array:
    """Poses (n, 4, 4) turned about the centroid and shifted by random shares of `low` to `high` diameters."""
    size, turn, shift = rng.uniform(low, high, len(truth)), rng.random(len(truth)), rng.random(len(truth))
    rotation = poses.from_axis_angle(rng.standard_normal((len(truth), 3)), TURN * size * turn)
    direction = rng.standard_normal((len(truth), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    center = model.centers(truth)
    place = center + direction * (model.diameter * size * shift)[:, None]
    return poses.from_rotation_translation(rotation, place - np.einsum("nij,nj->ni", rotation, center)) @ truth


def table(found: dict[str, list[tuple[bool, Verdict]]]) -> str:
    head = "| poses | count | right | verified | contradicted | undecided | decided ones agree | all agree |"
    every = [row for rows in found.values() for row in rows]
    rows = [_row(kind, some) for kind, some in [*found.items(), ("all", every)]]
    return "\n".join([head, "|---" * 8 + "|", *rows])


def _row(kind: str, rows: list[tuple[bool, Verdict]]) -> str:
    counts = [sum(verdict is one for _, verdict in rows) for one in Verdict]
    agree = np.array([right == (verdict is Verdict.VERIFIED) for right, verdict in rows])
    decided = np.array([verdict is not Verdict.UNDECIDED for _, verdict in rows])
    right = sum(right for right, _ in rows)
    cells = [kind, len(rows), right, *counts, f"{agree[decided].mean():.3f}", f"{agree.mean():.3f}"]
    return "| " + " | ".join(map(str, cells)) + " |"


if __name__ == "__main__":
    main()
