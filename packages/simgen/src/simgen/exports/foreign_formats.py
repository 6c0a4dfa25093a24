"""Shards as a dataset in somebody else's format: every frame, in the order of the shards, resumable."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop import export as bop_export
from evalkit.adapters.sileane import export as sileane_export
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.datasets.shard_format import checksum_problem, sha256_stated
from evalkit.errors import InputError
from simgen.exports.staged_folder import staged_folder

OnFrames = Callable[[int], object]


def open_whole(shards: Path) -> ShardDataset:
    """The dataset, every byte of which is as it was written.

    Raises:
        InputError: there is none, or a shard is missing or damaged.
    """
    dataset = ShardDataset(shards)
    for path in dataset.paths:
        problem = checksum_problem(path)
        if problem is not None:
            raise InputError(f"{path}: {problem}; delete it and run 'simgen build' again, then export.")
    return dataset


def export_bop(dataset: ShardDataset, out: Path, split: str, on_frames: OnFrames) -> None:
    """Write `dataset` as the BOP dataset `out`, its images as one split; scenes that are complete there are kept.

    Args:
        on_frames: called with the number of frames that were just done.

    Raises:
        InputError: `out` is not empty, or a frame cannot be read.
        OSError: `out` cannot be written.
    """
    head = dataset.header
    with staged_folder(out, {"format": "bop", "split": split, "shards": _stated(dataset)}) as part:
        bop_export.write_dataset_files(part, head.object, head.camera, head.depth_unit)
        silhouettes, origin = _Silhouettes(dataset), bop_export.origin_in_mesh(head.object)
        for scene, frames in _scenes(dataset):
            target = part / split / f"{scene:06d}"
            if not target.exists():
                begun = target.with_name(f".{target.name}")
                shutil.rmtree(begun, ignore_errors=True)
                views = (_told(dataset[frame], on_frames) for frame in frames)
                bop_export.write_scene(begun, views, silhouettes, origin)
                os.replace(begun, target)
            else:
                on_frames(len(frames))
        bop_export.write_targets(part, _visibilities(dataset))


def export_sileane(dataset: ShardDataset, out: Path, on_frames: OnFrames) -> None:
    """Write `dataset` as the folder `out` of one object in Siléane's files; images that are complete there are kept.

    Raises:
        InputError: `out` is not empty, or a frame cannot be read.
        OSError: `out` cannot be written.
    """
    head = dataset.header
    readers = [dataset.reader(shard) for shard in range(len(dataset.paths))]
    cam_from_world = sileane_export.shared_view(np.concatenate([reader.cam_from_world for reader in readers]))
    with staged_folder(out, {"format": "sileane", "shards": _stated(dataset)}) as part:
        sileane_export.write_dataset_files(part, head.object, head.camera, head.depth_unit, cam_from_world)
        for frame in range(len(dataset)):
            reader, row = dataset.locate(frame)
            if not sileane_export.labels_path(part, reader.image_id(row)).exists():
                sileane_export.write_view(part, reader[row], cam_from_world)
            on_frames(1)
        for leftover in part.rglob(".*.tmp"):  # of a killed attempt
            leftover.unlink()


class _Silhouettes:
    """Draws each instance of a view alone."""

    def __init__(self, dataset: ShardDataset) -> None:
        from simgen.rendering.rasterizer import Rasterizer

        model = dataset.header.object
        if model.vertices is None or model.faces is None:
            raise InputError(f"object '{model.title}' has no mesh in the shards; build them again with this simgen.")
        self._rasterizer = Rasterizer(dataset.header.camera, model.vertices, model.faces)

    def __call__(self, view: View) -> Iterator[NDArray[np.bool_]]:
        """The silhouettes (height, width) within the frame, in the labels' order."""
        for pose in view.instances.cam_from_obj:
            yield self._rasterizer.render(pose[None], view.cam_from_world).instance_id > 0


def _stated(dataset: ShardDataset) -> list[str | None]:
    """What distinguishes one dataset from another: the checksums of its shards."""
    return [sha256_stated(path) for path in dataset.paths]


def _scenes(dataset: ShardDataset) -> Iterator[tuple[int, range]]:
    """Each scene's number and its frames, which lie together."""
    scene = dataset.scene_index
    starts = [*np.flatnonzero(np.diff(scene, prepend=scene[:1] - 1)).tolist(), len(scene)]
    for start, end in pairwise(starts):
        yield int(scene[start]), range(start, end)


def _visibilities(dataset: ShardDataset) -> Iterator[tuple[int, int, NDArray[np.float64]]]:
    for frame in range(len(dataset)):
        reader, row = dataset.locate(frame)
        yield int(reader.scene_index[row]), int(reader.view_index[row]), reader.labels(row).visibility("geometric")


def _told(view: View, on_frames: OnFrames) -> View:
    on_frames(1)
    return view
