"""Point pair voting (Drost et al. 2010) by OpenCV contrib; run by ppf_baseline.py in an environment of its own.

    python ppf_voting.py FOLDER

FOLDER/model.npy (m, 6) and FOLDER/scene-*.npy (n, 6) hold points in meters and unit normals. Of each scene
FOLDER/votes-*.npz tells OpenCV's own clusters and the raw hypotheses before clustering, each with poses (k, 4, 4) and
votes (k,), and the seconds of either. Needs numpy and cv2 only.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SAMPLING = 0.05  # of the object's extent: distance of sampled points, and step of their distances in the table
ANGLES = 30
REFERENCE_SHARE = 0.2  # of the sampled scene's points vote
# OpenCV's clusters reach over 0.05 units of length, whatever the unit, and Python cannot set it: in meters that is half
# a bunny, in micrometers nothing, so that every hypothesis stays what it is.
UNITS_PER_METER = {"clustered": 1.0, "raw": 1e6}


def main() -> None:
    folder = Path(sys.argv[1])
    model = np.load(folder / "model.npy", allow_pickle=False)
    size = float(np.linalg.norm(np.ptp(model[:, :3], axis=0)))
    detectors = {name: _trained(model, scale) for name, scale in UNITS_PER_METER.items()}
    for path in sorted(folder.glob("scene-*.npy")):
        scene = np.load(path, allow_pickle=False)
        # OpenCV samples a scene by shares of the scene's extent: such that the points lie as far apart as the model's.
        step = SAMPLING * size / float(np.ptp(scene[:, :3], axis=0).max())
        found: dict[str, Any] = {}
        for name, scale in UNITS_PER_METER.items():
            wall, cpu = time.perf_counter(), time.process_time()
            results = detectors[name].match(_scaled(scene, scale), REFERENCE_SHARE, step)
            found[f"{name}_seconds"] = np.array([time.perf_counter() - wall, time.process_time() - cpu])
            found[f"{name}_poses"], found[f"{name}_votes"] = _arrays(results, scale)
        np.savez(path.with_name(f"votes-{path.stem.removeprefix('scene-')}.npz"), **found)
        print(path.stem, len(found["raw_votes"]), "hypotheses", flush=True)


def _trained(model: NDArray[np.float32], scale: float) -> Any:
    contrib: Any = cv2  # of opencv-contrib, which the project itself does not have
    detector = contrib.ppf_match_3d.PPF3DDetector(SAMPLING, SAMPLING, ANGLES)
    detector.trainModel(_scaled(model, scale))
    return detector


def _scaled(cloud: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """The same cloud (n, 6) in units of which `scale` are a meter."""
    return cloud * np.array([scale] * 3 + [1.0] * 3, np.float32)


def _arrays(results: Any, scale: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses (k, 4, 4) in meters and votes (k,)."""
    poses = np.array([result.pose for result in results], float).reshape(-1, 4, 4)
    poses[:, :3, 3] /= scale
    return poses, np.array([result.numVotes for result in results], float)


if __name__ == "__main__":
    main()
