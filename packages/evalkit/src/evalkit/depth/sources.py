"""Where depth images come from: shards, one image, a folder of images, a folder of BOP or Siléane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop import dataset as bop
from evalkit.adapters.bop.mesh_frame import stated_origins
from evalkit.adapters.sileane import dataset as sileane
from evalkit.datasets.shard_folder import DATASET_FILE, ShardDataset
from evalkit.depth import point_cloud, stored
from evalkit.depth.clean import clean_depth
from evalkit.depth.images import SUFFIXES, Reading
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_files import read_camera
from evalkit.image_file import is_picture
from evalkit.objects.model import ObjectModel

SOURCES = (
    "a folder of shards, a depth image or a folder of them (PNG, PGM, TIFF, NPY, NPZ, EXR, organized PLY or "
    "PCD) with --camera, "
    "or a scene or split of a BOP dataset, or a folder of the Siléane dataset"
)


@dataclass(frozen=True)
class DepthSource:
    """Named depth images, each with its camera, read one at a time.

    Attributes:
        remarks: sentences on what was chosen and applied.
        truth: what `evalkit gt --from` reads the source's ground truth by, None where it has none.
        truth_options: what else to tell it.
        models_info: of a set by `simgen export bop`, the file that says where its models' origins lie in their meshes.
        model: the object that the images show, where the source says so.
    """

    path: Path
    names: list[str]
    cameras: list[Camera]  # one an image
    read: Callable[[int], NDArray[np.float32]]  # number of an image -> (height, width) meters, 0 = no return
    remarks: tuple[str, ...] = ()
    truth: str | None = None
    model: ObjectModel | None = None
    truth_options: tuple[str, ...] = ()
    models_info: Path | None = None

    @property
    def camera(self) -> Camera:
        """The camera of the first image."""
        return self.cameras[0]

    def depth(self, number: int) -> NDArray[np.float32]:
        """An image (height, width) in meters, 0 where nothing returned, whatever its source writes there.

        Raises:
            InputError: it cannot be used.
        """
        return clean_depth(self.read(number), self.cameras[number], f"image '{self.names[number]}'")

    def spread(self, most: int | None) -> list[int]:
        """Numbers of at most `most` images, evenly spread over the source."""
        count = min(most or len(self.names), len(self.names))
        return [int(number) for number in np.linspace(0, len(self.names) - 1, count).round()]


def open_source(
    path: Path,
    camera_file: Path | None = None,
    depth_unit: float | None = None,
    reading: Reading | None = None,
    rectified: bool = False,
    targets: Path | None = None,
    sensor: str | None = None,
) -> DepthSource:
    """Whatever lies at `path`: its content decides what it is.

    Args:
        camera_file: of image files; see :func:`evalkit.geometry.camera_files.read_camera`.
        depth_unit: meters a step of image files.
        reading: how image files are to be read otherwise.
        rectified: image files were rectified, so that the camera's lens does not matter.
        targets: of a BOP dataset, only the images that this test_targets_bop*.json lists.
        sensor: of a BOP dataset with several, this one, such as cam1.

    Raises:
        InputError: nothing usable lies there, or images come without their camera.
    """
    reading = replace(reading or Reading(), depth_unit=depth_unit)
    files_only = camera_file is not None or reading != Reading() or rectified
    if _is_shards(path):
        _refuse(files_only or targets is not None, path, "shards", "image files")
        return open_shards(path)
    if path.is_dir() and camera_file is None and _is_bop(path, sensor, targets):
        _refuse(files_only, path, "a BOP dataset", "image files")
        return open_bop(path, targets, sensor)
    if targets is not None or sensor is not None:
        raise InputError(f"{path}: is no BOP dataset with scene_camera.json, which --targets and --sensor speak of.")
    if path.is_dir() and not files_only:
        home = next((folder for folder in (path, path.parent) if (folder / sileane.CAMERA_FILE).is_file()), None)
        if home is not None:
            return open_sileane(path, home)
    return open_images(path, camera_file, reading, rectified)


def _refuse(given: bool, path: Path, kind: str, other: str) -> None:
    if given:
        raise InputError(f"{path}: holds {kind}, which say all by themselves; leave out the options for {other}.")


def open_shards(path: Path) -> DepthSource:
    """The depth images of shards; their labels are never read."""
    dataset = ShardDataset(path)
    unit = np.float32(dataset.header.depth_unit)
    located = [dataset.locate(number) for number in range(len(dataset))]
    names = [reader.image_id(row) for reader, row in located]

    def read(number: int) -> NDArray[np.float32]:
        reader, row = located[number]
        return reader.depth_raw(row) * unit

    return DepthSource(path, names, [dataset.header.camera] * len(names), read, (), "shards", dataset.header.object)


def open_images(
    path: Path, camera_file: Path | None, reading: Reading | None = None, rectified: bool = False
) -> DepthSource:
    """One depth image, or all of a folder; an image is named as its file without the suffix.

    Without `camera_file`, a camera.json in the folder is taken, and organized clouds tell their own camera.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; give {SOURCES}.")
    files, beside_them = _images_in(path) if path.is_dir() else ([path], [])
    beside = next(
        (folder / "camera.json" for folder in (files[0].parent, path) if (folder / "camera.json").is_file()), None
    )
    reading, remarks = reading or Reading(), list(beside_them)
    if camera_file is None and beside is not None and path.is_dir():
        camera_file = beside
        remarks.append(f"{beside}: is taken as the images' camera; --camera gives another.")
    if camera_file is None and files[0].suffix.lower() in point_cloud.SUFFIXES:
        camera = point_cloud.fitted_camera(point_cloud.read_grid(files[0]), files[0])
        remarks.append(f"{files[0]}: its points' own grid gives the camera: fx {camera.fx:.5g}, fy {camera.fy:.5g}.")
    elif camera_file is None:
        raise InputError(f"{path}: a depth image needs its camera: give --camera camera.json.")
    else:
        found = read_camera(camera_file, rectified, partial(reading.size, files[0]))
        camera, reading = found.camera, replace(reading, lens=found.lens)
        remarks += found.remarks
        if found.lens is not None:
            remarks.append(
                f"{camera_file}: images are rectified, for the lens distorts them ({found.lens.describe()})."
            )
        if reading.depth_unit is None and found.depth_unit is not None:
            reading = replace(reading, integer_unit=found.depth_unit)
            remarks.append(f"{camera_file}: its depth_scale gives whole numbers {found.depth_unit:g} m a step.")
    names, cameras = [file.stem for file in files], [camera] * len(files)
    return DepthSource(path, names, cameras, lambda number: reading.image(files[number], camera), tuple(remarks))


def open_bop(path: Path, targets: Path | None = None, sensor: str | None = None) -> DepthSource:
    """A BOP dataset's split (DATASET/test), one of its scenes, or with `targets` the whole dataset.

    Every image has its own camera and scale of depth; images are named as scene and image number, 000001-000003.

    Raises:
        InputError: a file is missing or is not what it should be.
    """
    split = _split_of(path, targets)
    images = list(bop.depth_images(split, sensor=sensor, targets=targets))
    if not images:
        raise InputError(f"{path}: holds none of the images that {targets} lists; give the split that it is of.")
    origins = stated_origins(split)
    given = {"--targets": targets, "--sensor": sensor}
    options = [str(word) for option, value in given.items() if value is not None for word in (option, value)]
    return DepthSource(
        split,
        [image.id for image in images],
        [image.camera for image in images],
        lambda number: images[number].read().astype(np.float32),
        truth="bop",
        truth_options=(*options, *(["--mesh-frame"] if origins is not None else [])),
        models_info=origins,
    )


def _split_of(path: Path, targets: Path | None) -> Path:
    """The split of a dataset's folder that its targets speak of: test, or the only one that there is."""
    if targets is None or next(path.glob("scene_camera*.json"), None) or next(path.glob("*/scene_camera*.json"), None):
        return path
    splits = sorted({file.parents[1] for file in path.glob("*/*/scene_camera*.json")})
    named = [split for split in splits if split.name == targets.name.removesuffix(".json").split("_")[0]]
    if len(named or splits) != 1:
        listed = ", ".join(split.name for split in splits)
        raise InputError(f"{path}: holds several splits ({listed}); give the one that {targets.name} is of.")
    return (named or splits)[0]


def _is_bop(path: Path, sensor: str | None, targets: Path | None) -> bool:
    """Whether a folder is a scene, a split or a dataset of BOP; one without cameras is refused.

    Raises:
        InputError: it is a scene or a split of BOP, but without cameras.
    """
    levels = ("", "*/", "*/*/")
    if any(next(path.glob(f"{level}scene_camera*.json"), None) is not None for level in levels):
        return True
    if any(next(path.glob(f"{level}scene_gt*.json"), None) is not None for level in levels):
        raise InputError(
            f"{path}: a BOP dataset without scene_camera.json, and so without cameras; fetch it again, or give one "
            "folder of its depth images with --camera and --depth-unit."
        )
    return False


def open_sileane(folder: Path, home: Path) -> DepthSource:
    """A folder of the Siléane dataset (Brégier et al. 2017): FOLDER/depth/*.png, or the images in FOLDER itself.

    `home` holds camera_params.txt; images are named as their files, and so as the scenes of the ground truth.
    """
    inner = folder / "depth"
    images = list(sileane.clipped_images(inner if inner.is_dir() else folder, home / sileane.CAMERA_FILE))
    return DepthSource(
        folder,
        [image.id for image in images],
        [image.camera for image in images],
        lambda number: images[number].read().astype(np.float32),
        truth="sileane" if (home / "poseutils.json").is_file() else None,
    )


def _is_shards(path: Path) -> bool:
    if path.is_dir():
        return (path / DATASET_FILE).is_file() or any(path.glob("shard-*.h5"))
    return path.suffix.lower() in (".h5", ".hdf5")


def _images_in(folder: Path) -> tuple[list[Path], list[str]]:
    """The depth images of a folder, and a remark on what else is there: color images, masks, a part's mesh."""
    listed = sorted(file for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    every = [file for file in listed if file.suffix.lower() in SUFFIXES]
    if not every:
        raise InputError(f"{folder}: holds neither shards nor depth images; {_instead(folder, listed)}.")
    files = [file for file in every if not is_picture(file)]
    images = [file for file in files if file.suffix.lower() not in point_cloud.SUFFIXES]
    named = [file for file in images if stored.DEPTH_NAME.search(file.stem)]
    files = named or images or files or every
    by_name = {file.stem: file for file in files}
    twin = next((file for file in files if by_name[file.stem] != file), None)
    if twin is not None:
        raise InputError(f"{twin}: has the same name as {by_name[twin.stem].name}; keep one image of each name.")
    others = [file.name for file in every if file not in set(files)]
    if not others:
        return files, []
    more = f" and {len(others) - 1} more" if len(others) > 1 else ""
    count = "one depth image is" if len(files) == 1 else f"{len(files)} depth images are"
    return files, [f"{folder}: {count} read; left out is what holds none, {others[0]}{more}."]


def _instead(folder: Path, files: list[Path]) -> str:
    """What to give in place of a folder without depth images."""
    inner = next((f for f in sorted(folder.iterdir()) if f.is_dir() and stored.DEPTH_NAME.search(f.name)), None)
    if inner is not None:
        return f"give the folder in it, {inner}"
    useless = next((file for file in files if file.suffix.lower() in stored.USELESS), None)
    if useless is not None:
        return f"of {useless.name}, {stored.USELESS[useless.suffix.lower()]}: save depth as {stored.KINDS}"
    return f"give {SOURCES}"
