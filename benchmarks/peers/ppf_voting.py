"""Point pair voting (Drost et al. 2010) by OpenCV contrib; `peers.contrib` runs it in an environment of its own.

    python ppf_voting.py FOLDER

FOLDER/model.npy (m, 6) and FOLDER/scene-*.npy (n, 6) hold points in millimeters and unit normals, sampled already. For
each scene FOLDER/found-*.npz gets the raw hypotheses, one a reference point: poses (k, 4, 4) in millimeters, votes
(k,), and the wall and CPU seconds. What is there already is left as it is. Needs numpy and cv2 only.

The clouds are in millimeters because OpenCV clusters over 0.05 of whatever unit they have, and Python cannot set that:
in meters that is half a bunny and its test of rotation does not hold poses apart, in millimeters nothing is merged.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# OpenCV samples both clouds once more by a grid of shares of their extent. They come sampled as we want them, sides of
# thin walls apart, so this grid is finer.
MODEL_GRID, SCENE_GRID = 0.02, 0.01
DISTANCE_STEP = 0.05  # of the model's diagonal, in the table of point pairs
ANGLES = 30
REFERENCE_SHARE = 0.25  # of the scene's points vote


def main() -> None:
    folder, detector = Path(sys.argv[1]), None
    for path in sorted(folder.glob("scene-*.npy")):
        out = path.with_name(f"found-{path.name.removeprefix('scene-').removesuffix('.npy')}.npz")
        if out.exists():
            continue
        detector = detector or _trained(np.load(folder / "model.npy", allow_pickle=False))
        wall, cpu = time.perf_counter(), time.process_time()
        results = detector.match(np.load(path, allow_pickle=False), REFERENCE_SHARE, SCENE_GRID)
        seconds = np.array([time.perf_counter() - wall, time.process_time() - cpu])
        poses, votes = _arrays(results)
        partial = out.with_name(f".{out.name}")
        with partial.open("wb") as file:
            np.savez(file, poses=poses, strength=votes, seconds=seconds)
        os.replace(partial, out)
        print(path.stem, len(votes), "hypotheses", flush=True)


def _trained(model: NDArray[np.float32]) -> Any:
    contrib: Any = cv2  # of opencv-contrib, which the project itself does not have
    detector = contrib.ppf_match_3d.PPF3DDetector(MODEL_GRID, DISTANCE_STEP, ANGLES)
    detector.trainModel(model)
    return detector


def _arrays(results: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses (k, 4, 4) and votes (k,)."""
    poses = np.array([result.pose for result in results], float).reshape(-1, 4, 4)
    return poses, np.array([result.numVotes for result in results], float)


if __name__ == "__main__":
    main()
