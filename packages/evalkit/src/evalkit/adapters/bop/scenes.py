"""Where the files of a BOP dataset lie: splits, scenes, sensors, images.

``SPLIT/000001/`` holds JSON files that say something of each image by its number, and a folder for each kind of image.
Sets of several sensors add the sensor's name to all of them (``scene_gt_cam1.json``, ``depth_cam1/000000.png``).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop.object import METERS
from evalkit.adapters.depth_images import read_raw_depth
from evalkit.errors import InputError
from evalkit.json_file import load_json

Array = NDArray[np.float64]
IMAGE_KINDS = ("depth", "gray", "rgb")
SUFFIXES = (".png", ".tif", ".tiff", ".jpg")
LEVELS_UP = 2  # from a scene's folder to the dataset's


@dataclass(frozen=True)
class Scene:
    """A folder of images by one sensor."""

    folder: Path
    number: int
    sensor: str = ""

    def file(self, stem: str) -> Path:
        return self.folder / f"{stem}{self.sensor}.json"

    def entries(self, stem: str) -> dict[int, Any]:
        """What a file says of each image, by the image's number."""
        path = self.file(stem)
        document = load_json(path)
        if not isinstance(document, dict) or not all(key.isdecimal() for key in document):
            raise InputError(f'{path}: expected {{"image number": …}}, as BOP has it.')
        return {int(key): document[key] for key in sorted(document, key=int)}

    def image(self, number: int, kinds: Iterable[str] = IMAGE_KINDS) -> Path | None:
        """The first picture there is of an image."""
        names = (self.folder / f"{kind}{self.sensor}" / f"{number:06d}{end}" for kind in kinds for end in SUFFIXES)
        return next((name for name in names if name.is_file()), None)

    def read_depth(self, number: int, scale: float) -> Array:
        """The depth image (height, width) in meters, 0 = no return; `scale` is millimeters a step."""
        path = self.image(number, ("depth",)) or self.folder / f"depth{self.sensor}" / f"{number:06d}.png"
        return read_raw_depth(path) * (scale * METERS)


def find_scenes(folder: Path, sensor: str | None = None, stem: str = "scene_gt") -> list[Scene]:
    """The scenes in a split's folder, or the one scene that `folder` is: what holds the file `stem`.

    Raises:
        InputError: there is none, or the set has several sensors and `sensor` names none of them.
    """
    name = "" if sensor is None else f"_{sensor}"
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a BOP split such as DATASET/test.")
    candidates = [folder, *sorted(path for path in folder.iterdir() if path.is_dir())]
    scenes = [path for path in candidates if (path / f"{stem}{name}.json").is_file()]
    if not scenes:
        raise InputError(_no_scenes(folder, candidates, stem))
    lacking = [] if folder in scenes else [path for path in candidates if path not in scenes and _is_scene(path)]
    if lacking:
        raise InputError(
            f"{lacking[0]}: lacks {stem}{name}.json, which {scenes[0].name} has; fetch it again, or give one scene."
        )
    for path in scenes:
        if not path.resolve().name.isdecimal():
            raise InputError(f"{path}: a scene's folder must be named by its number, such as 000001.")
    return [Scene(path, int(path.resolve().name), name) for path in scenes]


def _is_scene(folder: Path) -> bool:
    return folder.name.isdecimal() and (next(folder.glob("scene_*.json"), None) or folder / "depth").exists()


def _no_scenes(folder: Path, candidates: list[Path], stem: str) -> str:
    sensors = sorted({path.stem[len(stem) + 1 :] for place in candidates for path in place.glob(f"{stem}_*.json")})
    sensors = [name for name in sensors if not name.startswith(("info", "coco"))]
    if sensors:
        return f"{folder}: its scenes have several sensors; give --sensor {' or '.join(sensors)}."
    splits = [path for path in candidates[1:] if next(path.glob(f"*/{stem}*.json"), None)]
    if splits:
        return f"{folder}: is a whole dataset; give one of its splits, such as {splits[0]}."
    return f"{folder}: neither it nor its folders hold {stem}.json; the ground truth of some BOP splits is not public."


def dataset_folder(scene: Path) -> Path | None:
    """The folder that holds models*/, above a scene's folder; None where there is none."""
    above = list(scene.resolve().parents)[:LEVELS_UP]
    return next((folder for folder in above if any(path.is_dir() for path in folder.glob("models*"))), None)
