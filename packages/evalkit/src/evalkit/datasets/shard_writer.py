"""One shard, written frame by frame; it appears when complete."""

from __future__ import annotations

import os
import re
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_format import (
    COMPRESSIONS,
    INSTANCE_DTYPES,
    INSTANCE_FIELDS,
    INSTANCE_SHAPES,
    SCHEMA,
    ShardHeader,
    compression_filters,
    create_file,
    seal,
    write_array,
    write_header,
)
from evalkit.errors import InputError


class ShardWriter:
    """Writes one shard frame by frame, so that memory does not grow with it; the file appears when complete.

    Use as a context manager; leaving it by an exception leaves no file.

    Raises:
        InputError: `compression` is unknown, fewer frames were appended than announced, or `keep_ideal` asks for
            ideal depth that a frame lacks.
        OSError: the folder cannot be written.
    """

    def __init__(
        self, path: Path | str, header: ShardHeader, frames: int, compression: str = "zstd", keep_ideal: bool = False
    ) -> None:
        if compression not in COMPRESSIONS:
            raise InputError(f"compression '{compression}' is not known; use one of {', '.join(COMPRESSIONS)}.")
        self.path, self.header, self.frames, self.keep_ideal = Path(path), header, frames, keep_ideal
        self._filters = compression_filters(compression)
        self._appended = 0
        self._rows: list[Instances] = []
        self._per_frame: list[tuple[int, int, NDArray[np.float64]]] = []

    def __enter__(self) -> ShardWriter:
        self._atomic = atomic_path(self.path)
        self._temporary = self._atomic.__enter__()
        try:
            self._file = create_file(self._temporary)
            self._prepare_frames()
        except BaseException as error:
            self._atomic.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def append(self, view: View) -> None:
        """Add the next frame; frames come scene by scene, view by view."""
        self._file["depth"][self._appended] = view.depth_raw
        self._file["instance_id"][self._appended] = view.instance_id
        if self.keep_ideal:
            if view.depth_ideal_raw is None:
                raise InputError(f"{self.path}: frame {view.image_id} has no ideal depth, which was to be kept.")
            self._file["depth_ideal"][self._appended] = view.depth_ideal_raw
        self._rows.append(view.instances)
        self._per_frame.append((view.scene_index, view.view_index, view.cam_from_world))
        self._appended += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                if self._appended != self.frames:
                    raise InputError(
                        f"{self.path}: {self._appended} frames written where {self.frames} were announced."
                    )
                self._write_labels()
            self._file.close()
            if kind is None:
                seal(self._temporary, SCHEMA)
        except BaseException as failure:
            self._atomic.__exit__(type(failure), failure, failure.__traceback__)
            _raise_as_os_error(failure, self.path)
            raise
        self._atomic.__exit__(kind, error, trace)
        _raise_as_os_error(error, self.path)

    def _prepare_frames(self) -> None:
        head, file = self.header, self._file
        write_header(file, head, SCHEMA, self._filters)
        shape = (head.camera.height, head.camera.width)
        names = ("depth", *(("depth_ideal",) if self.keep_ideal else ()), "instance_id")
        for name in names:
            shuffle = name != "instance_id"  # depth's low bytes are noise, its high not
            file.create_dataset(
                name,
                (self.frames, *shape),
                "<u2",
                chunks=(1, *shape),
                shuffle=shuffle,
                fletcher32=True,
                **self._filters,
            )

    def _write_labels(self) -> None:
        write_array(self._file, "scene_index", np.array([f[0] for f in self._per_frame], "<i4"), self._filters)
        write_array(self._file, "view_index", np.array([f[1] for f in self._per_frame], "<i4"), self._filters)
        write_array(
            self._file,
            "cam_from_world",
            np.array([f[2] for f in self._per_frame], "<f8").reshape(-1, 4, 4),
            self._filters,
        )
        write_array(
            self._file, "frame_offset", np.cumsum([0, *(len(rows) for rows in self._rows)]).astype("<i8"), self._filters
        )
        for name in INSTANCE_FIELDS:
            shape = INSTANCE_SHAPES.get(name, ())
            parts = [np.asarray(getattr(rows, name)).reshape(-1, *shape) for rows in self._rows]
            stacked = np.concatenate(parts) if parts else np.zeros((0, *shape))
            write_array(self._file, name, stacked.astype(INSTANCE_DTYPES[name]), self._filters)


def _raise_as_os_error(failure: BaseException | None, path: Path) -> None:
    """On a full disk HDF5 may raise a RuntimeError; raise the OSError that it is. Anything else is left alone."""
    match = re.search(r"errno = (\d+)", str(failure)) if isinstance(failure, RuntimeError) else None
    if match is not None:
        raise OSError(int(match[1]), os.strerror(int(match[1])), str(path)) from failure
