"""One shard, read frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_damage import damage_named
from evalkit.datasets.shard_format import (
    COUNTED_FIELDS,
    INSTANCE_FIELDS,
    OLD_NAMES,
    OLD_SCHEMA,
    SCHEMA,
    read_header,
)
from evalkit.errors import InputError

IDS = np.iinfo(np.uint16).max + 1  # values that a pixel of instance_id can have


class ShardReader:
    """Random access to the frames of one shard: ``reader[i]`` is a :class:`View`.

    Raises:
        InputError: the file is missing, damaged, or not of this schema; the sentence names it and the mend.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(
                f"{path}: no such shard; check the path or run 'simgen build' again to complete the folder."
            )
        with damage_named(path, "not a readable HDF5 file (truncated or damaged)"):
            self._file = h5py.File(self.path, "r")
        try:
            with damage_named(path):
                self._read_labels()
        except InputError:
            self._file.close()
            raise

    def __len__(self) -> int:
        return len(self._scene)

    def __getitem__(self, index: int) -> View:
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self.path}: frame {index} of {len(self)}")
        index %= len(self)
        return self._make_view(index, self._pixels("depth", index), self._pixels("instance_id", index))

    def __iter__(self) -> Iterator[View]:
        return (self[index] for index in range(len(self)))

    def depth_raw(self, index: int) -> NDArray[np.uint16]:
        """The stored depth (H, W) alone: all that a predictor may look at."""
        return self._pixels("depth", index)

    def labels(self, index: int) -> Instances:
        """The labels alone, without reading pixels, save where a shard of schema 1 has them counted."""
        return self._make_labels(index, None)

    @property
    def has_ideal(self) -> bool:
        """Whether the depth without the sensor's errors was kept."""
        return "depth_ideal" in self._file

    def image_id(self, index: int) -> str:
        return f"{self._scene[index]:06d}-{self._view[index]:03d}"

    @property
    def scene_index(self) -> NDArray[np.int32]:
        """Scene of each frame (F,)."""
        return np.asarray(self._scene)

    @property
    def view_index(self) -> NDArray[np.int32]:
        """View of its scene of each frame (F,)."""
        return np.asarray(self._view)

    @property
    def cam_from_world(self) -> NDArray[np.float64]:
        """Camera pose of each frame (F, 4, 4)."""
        return np.asarray(self._cam_from_world)

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> ShardReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read_labels(self) -> None:
        """All but the pixels, which are read when they are asked for."""
        self.header = read_header(self._file, self.path, SCHEMA, OLD_SCHEMA)
        self.schema = str(self._file.attrs["schema"])
        self._labels = {name: self._file[stored][()] for name, stored in instance_names(self.schema).items()}
        self._offset = self._file["frame_offset"][()]
        self._scene, self._view = self._file["scene_index"][()], self._file["view_index"][()]
        self._cam_from_world = self._file["cam_from_world"][()]

    def _make_view(self, index: int, depth: NDArray[np.uint16], ids: NDArray[np.uint16]) -> View:
        return View(
            camera=self.header.camera,
            depth_raw=depth,
            depth_unit=self.header.depth_unit,
            instance_id=ids,
            cam_from_world=self._cam_from_world[index],
            instances=self._make_labels(index, ids),
            scene_index=int(self._scene[index]),
            view_index=int(self._view[index]),
            depth_ideal_raw=self._pixels("depth_ideal", index) if self.has_ideal else None,
        )

    def _make_labels(self, index: int, ids: NDArray[np.uint16] | None) -> Instances:
        rows = slice(self._offset[index], self._offset[index + 1])
        found = {name: values[rows] for name, values in self._labels.items()}
        if self.schema == OLD_SCHEMA:
            found |= _counted(found, self._pixels("instance_id", index) if ids is None else ids)
        return Instances(**found)

    def _pixels(self, name: str, index: int) -> NDArray[np.uint16]:
        with damage_named(self.path, f"frame {index} is damaged"):
            return np.asarray(self._file[name][index])


def instance_names(schema: str) -> dict[str, str]:
    """Fields of :class:`Instances` that a shard of `schema` stores, and the names that it stores them by."""
    if schema == SCHEMA:
        return {name: name for name in INSTANCE_FIELDS}
    return {name: OLD_NAMES.get(name, name) for name in INSTANCE_FIELDS if name not in COUNTED_FIELDS}


def _counted(labels: dict[str, NDArray[Any]], ids: NDArray[np.uint16]) -> dict[str, NDArray[Any]]:
    """The fields that schema 1 lacks, from the instances' pixels `ids` (H, W)."""
    counts = np.bincount(ids.ravel(), minlength=IDS)
    pixels = counts[np.clip(labels["instance"] + 1, 0, IDS - 1)].astype(np.int32)  # of damaged labels too
    share = (pixels / np.maximum(labels["pixels_full"], 1)).astype(np.float32)
    return {"pixels_geometric": pixels, "visibility_geometric": share}
