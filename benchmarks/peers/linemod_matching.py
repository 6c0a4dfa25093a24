"""Linemod (Hinterstoisser et al. 2011), depth's modality alone, by OpenCV contrib; `peers.contrib` runs it.

    python linemod_matching.py FOLDER

FOLDER/templates.npy (n, S, S) holds depth images of the object alone, FOLDER/scene-*.npy (H, W) those to be searched,
both uint16 in one unit of length, FOLDER/step.npy () how many units part two surfaces. For each scene
FOLDER/found-*.npz gets the best matches: template (k,), the pixel (k, 2) of the scene where the template's corner comes
to lie, similarity (k,) in percent, and the wall and CPU seconds. What is there already is left as it is. Needs numpy
and cv2 only.
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

FEATURES = 63
DISTINCT = 2  # pixels about a feature whose normals fall into one bin
SAMPLING = [5, 8]  # pixels between the places that are tried, on the image and on that of half its size
SIMILARITIES = (80.0, 70.0, 60.0)  # percent: the first that finds enough
ENOUGH = 1500  # matches
PLACE, PLACE_MOST = 10, 60  # pixels of a place's side, and the matches that are kept there
FARTHEST = 65535
# OpenCV 5.0.0 wants sides that are multiples of 5 and of 16, and ends by a fault in images much smaller than this.
MULTIPLE, LEAST_WIDTH, LEAST_HEIGHT = 80, 640, 480


def main() -> None:
    folder, trained = Path(sys.argv[1]), None
    for path in sorted(folder.glob("scene-*.npy")):
        out = path.with_name(f"found-{path.name.removeprefix('scene-').removesuffix('.npy')}.npz")
        if out.exists():
            continue
        trained = trained or Trained(folder)
        wall, cpu = time.perf_counter(), time.process_time()
        template, corner, similarity = trained.match(np.load(path, allow_pickle=False))
        seconds = np.array([time.perf_counter() - wall, time.process_time() - cpu])
        partial = out.with_name(f".{out.name}")
        with partial.open("wb") as file:
            np.savez(file, template=template, corner=corner, strength=similarity, seconds=seconds)
        os.replace(partial, out)
        print(path.stem, len(template), "matches", flush=True)


class Trained:
    """A detector that knows the templates."""

    def __init__(self, folder: Path) -> None:
        contrib: Any = cv2  # of opencv-contrib, which the project itself does not have
        step = int(np.load(folder / "step.npy", allow_pickle=False))
        modality = contrib.linemod.DepthNormal_create(FARTHEST, step, FEATURES, DISTINCT)
        self.detector = contrib.linemod.Detector([modality], SAMPLING)
        self.template: list[int] = []  # of each that OpenCV accepted
        self.box: list[tuple[int, int]] = []  # the corner of its features' box
        for number, depth in enumerate(np.load(folder / "templates.npy", mmap_mode="r", allow_pickle=False)):
            mask = np.where(depth > 0, 255, 0).astype(np.uint8)
            accepted, box = self.detector.addTemplate([np.array(depth)], "object", mask)
            if accepted >= 0:  # else it has too few features
                self.template.append(number)
                self.box.append(box[:2])
        print(len(self.template), "templates", flush=True)

    def match(self, depth: NDArray[np.uint16]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Template (k,), corner (k, 2) and similarity (k,) of the best matches, best first."""
        for least in SIMILARITIES:
            matches, _ = self.detector.match([padded(depth)], least)
            if len(matches) >= ENOUGH:
                break
        accepted = np.array([m.template_id for m in matches], np.int64)
        corner = np.array([(m.x, m.y) for m in matches], np.int64).reshape(-1, 2) - np.array(self.box)[accepted]
        similarity = np.array([m.similarity for m in matches], float)
        kept = best_of_each_place(corner, similarity)
        return np.array(self.template)[accepted[kept]], corner[kept], similarity[kept]


def best_of_each_place(corner: NDArray[np.int64], similarity: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of matches at pixels (k, 2) with similarities (k,), best first, of which no place has too many."""
    order = np.argsort(-similarity, kind="stable")
    of = np.unique(corner[order] // PLACE, axis=0, return_inverse=True)[1].ravel()
    by_place = np.argsort(of, kind="stable")
    rank = np.empty(len(of), np.int64)
    rank[by_place] = np.arange(len(of)) - np.searchsorted(of[by_place], of[by_place])
    return order[rank < PLACE_MOST]


def padded(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The image (H, W) with nothing to its right and below, in a size that OpenCV takes."""
    height, width = depth.shape
    rows = max(-(-height // MULTIPLE) * MULTIPLE, LEAST_HEIGHT)
    columns = max(-(-width // MULTIPLE) * MULTIPLE, LEAST_WIDTH)
    return np.pad(depth, ((0, rows - height), (0, columns - width)))


if __name__ == "__main__":
    main()
