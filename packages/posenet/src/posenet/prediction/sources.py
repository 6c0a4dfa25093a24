"""Where depth images to predict on come from: shards, one image, a folder of images, a Siléane folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.sileane.dataset import CAMERA_FILE, read_camera_params
from evalkit.datasets.shard_folder import DATASET_FILE, ShardDataset
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.prediction.images import SUFFIXES, read_clipped_depth, read_depth


@dataclass(frozen=True)
class DepthSource:
    """Named depth images of one camera, read one at a time."""

    names: list[str]
    camera: Camera
    read: Callable[[int], NDArray[np.float32]]  # number of an image -> (height, width) metres, 0 = no return

    def spread(self, most: int | None) -> list[int]:
        """Numbers of at most `most` images, evenly spread over the source."""
        count = min(most or len(self.names), len(self.names))
        return [int(number) for number in np.linspace(0, len(self.names) - 1, count).round()]


def open_source(path: Path, camera_file: Path | None = None, depth_unit: float | None = None) -> DepthSource:
    """Whatever lies at `path`: its content decides what it is.

    Raises:
        InputError: nothing usable lies there, or images come without their camera.
    """
    if _is_shards(path):
        return open_shards(path)
    if path.is_dir() and camera_file is None and depth_unit is None:
        parameters = next((f / CAMERA_FILE for f in (path, path.parent) if (f / CAMERA_FILE).is_file()), None)
        if parameters is not None:
            return open_sileane(path, parameters)
    return open_images(path, camera_file, depth_unit)


def open_shards(path: Path) -> DepthSource:
    """The depth images of shards; their labels are never read."""
    dataset = ShardDataset(path)
    unit = np.float32(dataset.header.depth_unit)
    located = [dataset.locate(number) for number in range(len(dataset))]
    names = [reader.image_id(row) for reader, row in located]

    def read(number: int) -> NDArray[np.float32]:
        reader, row = located[number]
        return reader.depth_raw(row) * unit

    return DepthSource(names, dataset.header.camera, read)


def open_images(path: Path, camera_file: Path | None, depth_unit: float | None) -> DepthSource:
    """One depth image, or all of a folder; an image is named as its file without the suffix."""
    files = _images_in(path) if path.is_dir() else [path]
    if path.exists() and camera_file is None:
        raise InputError(f"{path}: a depth image needs its camera: give --camera camera.json.")
    if camera_file is None:
        raise InputError(f"{path}: no such file or folder; give shards, a depth image or a folder of them.")
    return DepthSource(
        [file.stem for file in files], Camera.load(camera_file), lambda number: read_depth(files[number], depth_unit)
    )


def open_sileane(folder: Path, parameters: Path) -> DepthSource:
    """A folder of the Siléane dataset (Brégier et al. 2017): FOLDER/depth/*.png, or the images in FOLDER itself.

    `parameters` is camera_params.txt; images are named as their files, and so as the scenes of the ground truth.
    """
    files = _images_in(folder / "depth" if (folder / "depth").is_dir() else folder)
    camera, _ = read_camera_params(parameters)
    read = partial(read_clipped_depth, clip=_clip_planes(parameters))
    return DepthSource([file.stem for file in files], camera, lambda number: read(files[number]))


def _is_shards(path: Path) -> bool:
    if path.is_dir():
        return (path / DATASET_FILE).is_file() or any(path.glob("shard-*.h5"))
    return path.suffix.lower() in (".h5", ".hdf5")


def _images_in(folder: Path) -> list[Path]:
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not files:
        raise InputError(
            f"{folder}: holds neither shards nor depth images; give a folder of shard-*.h5 or of {', '.join(SUFFIXES)}."
        )
    by_name = {file.stem: file for file in files}
    twin = next((file for file in files if by_name[file.stem] != file), None)
    if twin is not None:
        raise InputError(f"{twin}: has the same name as {by_name[twin.stem].name}; keep one image of each name.")
    return files


def _clip_planes(parameters: Path) -> tuple[float, float]:
    """The depths (metres) that the lowest and the highest value of a Siléane depth image stand for."""
    lines = (line.split() for line in parameters.read_text(encoding="utf-8", errors="replace").splitlines())
    fields = {words[0]: words[1] for words in lines if len(words) == 2}
    try:
        near, far = float(fields["clip_start"]), float(fields["clip_end"])
    except (KeyError, ValueError):
        near = far = 0.0
    if not 0 <= near < far < np.inf:
        raise InputError(
            f"{parameters}: the lines 'clip_start' and 'clip_end' must hold metres, the first the smaller."
        )
    return near, far
