"""The dataset on disk: a folder of HDF5 shards, each a fixed range of whole scenes. Schema ``binpose-shard/1``.

Per frame (F = scenes x views)::

    depth (F,H,W uint16)  instance_id (F,H,W uint16)  scene_index (F)  view_index (F)  cam_from_world (F,4,4)
    depth_ideal (F,H,W uint16), where it was kept: depth without the sensor's errors
    frame_offset (F+1)    rows of frame f in the per-instance arrays: frame_offset[f] .. frame_offset[f+1]

Per instance of each frame: the fields of :class:`evalkit.scene.Instances`. The mesh lies in ``object/vertices`` and
``object/faces``. Attributes: schema, camera, depth_unit, object, config, software (JSON), seed.

Integrity: every chunk carries a Fletcher-32 sum, and the file's first 512 bytes (HDF5's user block, which its readers
skip) hold the SHA-256 of all bytes after them. ``dataset.json`` beside the shards names the config, the object and the
shards that belong to the dataset. Nothing is ever unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path, write_json
from evalkit.camera import Camera
from evalkit.errors import InputError
from evalkit.objects import ObjectModel
from evalkit.scene import Instances, View

SCHEMA = "binpose-shard/1"
DATASET_SCHEMA = "binpose-dataset/1"
DATASET_FILE = "dataset.json"
USER_BLOCK = 512
COMPRESSIONS = ("zstd", "gzip")
_INSTANCE_FIELDS = tuple(f.name for f in fields(Instances))
_INSTANCE_DTYPES = {
    "instance": "<i4", "cam_from_obj": "<f8", "visibility": "<f4", "pixels_visible": "<i4", "pixels_full": "<i4",
    "box_visible": "<i4", "box_full": "<i4", "center_px": "<f4",
}  # fmt: skip
_INSTANCE_SHAPES = {"cam_from_obj": (4, 4), "box_visible": (4,), "box_full": (4,), "center_px": (2,)}


@dataclass(frozen=True, eq=False)
class ShardHeader:
    """What all frames of a shard share."""

    camera: Camera
    depth_unit: float
    object: ObjectModel
    config: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    software: dict[str, str] = field(default_factory=dict)


def shard_name(index: int) -> str:
    return f"shard-{index:05d}.h5"


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
        for name in _INSTANCE_FIELDS:
            shape = _INSTANCE_SHAPES.get(name, ())
            parts = [np.asarray(getattr(rows, name)).reshape(-1, *shape) for rows in self._rows]
            stacked = np.concatenate(parts) if parts else np.zeros((0, *shape))
            write_array(self._file, name, stacked.astype(_INSTANCE_DTYPES[name]), self._filters)


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
        try:
            self._file = h5py.File(self.path, "r")
        except OSError:
            raise InputError(
                f"{path}: not a readable HDF5 file (truncated or damaged); delete it and run 'simgen build' again."
            ) from None
        try:
            self.header = read_header(self._file, self.path, SCHEMA)
            self._labels = {name: self._file[name][()] for name in _INSTANCE_FIELDS}
            self._offset = self._file["frame_offset"][()]
            self._scene, self._view = self._file["scene_index"][()], self._file["view_index"][()]
            self._cam_from_world = self._file["cam_from_world"][()]
        except (OSError, KeyError, json.JSONDecodeError) as error:
            self._file.close()
            raise InputError(
                f"{path}: damaged or incomplete ({error}); delete it and run 'simgen build' again."
            ) from None

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
        """The labels alone, without reading pixels."""
        rows = slice(self._offset[index], self._offset[index + 1])
        return Instances(*(self._labels[name][rows] for name in _INSTANCE_FIELDS))

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

    def _make_view(self, index: int, depth: NDArray[np.uint16], ids: NDArray[np.uint16]) -> View:
        return View(
            camera=self.header.camera,
            depth_raw=depth,
            depth_unit=self.header.depth_unit,
            instance_id=ids,
            cam_from_world=self._cam_from_world[index],
            instances=self.labels(index),
            scene_index=int(self._scene[index]),
            view_index=int(self._view[index]),
            depth_ideal_raw=self._pixels("depth_ideal", index) if self.has_ideal else None,
        )

    def _pixels(self, name: str, index: int) -> NDArray[np.uint16]:
        try:
            return np.asarray(self._file[name][index])
        except OSError:
            raise InputError(
                f"{self.path}: frame {index} is damaged; delete the file and run 'simgen build' again."
            ) from None


class ShardDataset(Sequence[View]):
    """All frames of a folder of shards (or of listed shard files) as one sequence of :class:`View`.

    Safe to hand to worker processes: files are opened anew in each process, on first use.

    Raises:
        InputError: there is no shard, one is missing or damaged, or they differ in object, camera or depth unit.
    """

    def __init__(self, source: Path | str | Sequence[Path | str]) -> None:
        self.paths = list_shards(source)
        self._readers: dict[int, ShardReader] = {}
        self._pid = os.getpid()
        lengths = []
        for index in range(len(self.paths)):
            reader = self.reader(index)
            _require_same(self.reader(0), reader)
            lengths.append(len(reader))
        self.header = self.reader(0).header
        self._starts = np.cumsum([0, *lengths])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        reader, frame = self.locate(index)
        return reader[frame]

    def locate(self, index: int) -> tuple[ShardReader, int]:
        """The shard that holds frame `index`, and the frame's number in it."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        index %= len(self)
        shard = int(np.searchsorted(self._starts, index, side="right")) - 1
        return self.reader(shard), index - int(self._starts[shard])

    def reader(self, shard: int) -> ShardReader:
        """The open reader of one shard, this process's own."""
        if self._pid != os.getpid():
            self._readers, self._pid = {}, os.getpid()
        if shard not in self._readers:
            self._readers[shard] = ShardReader(self.paths[shard])
        return self._readers[shard]

    @property
    def scene_index(self) -> NDArray[np.int32]:
        """Scene of each frame (len(self),)."""
        return np.concatenate([self.reader(shard).scene_index for shard in range(len(self.paths))])

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_readers": {}}


def list_shards(source: Path | str | Sequence[Path | str]) -> list[Path]:
    """Shard files of a folder, one shard file, or a list of either.

    Raises:
        InputError: nothing is there, or dataset.json names shards that are missing.
    """
    if not isinstance(source, str | Path):
        return [path for part in source for path in list_shards(part)]
    source = Path(source)
    if source.is_file():
        return [source]
    if not source.is_dir():
        raise InputError(f"{source}: no such folder or shard; build one with 'simgen build -o {source}'.")
    found = sorted(source.glob("shard-*.h5"))
    if (source / DATASET_FILE).is_file():
        expected = {shard["name"] for shard in read_dataset_file(source)["shards"]}
        missing = sorted(expected - {path.name for path in found})
        if missing:
            raise InputError(
                f"{source}: {len(missing)} of {len(expected)} shards are missing (first: {missing[0]}); "
                "run the same 'simgen build' again to complete it."
            )
        found = [path for path in found if path.name in expected]
    if not found:
        raise InputError(f"{source}: the folder holds no shards (shard-*.h5); build some with 'simgen build'.")
    return found


def read_dataset_file(folder: Path | str) -> dict[str, Any]:
    """The parsed dataset.json of a folder.

    Raises:
        InputError: it is missing, not JSON, or of another schema.
    """
    path = Path(folder) / DATASET_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        known = document["format"] == DATASET_SCHEMA and all(isinstance(s["name"], str) for s in document["shards"])
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; build the folder with 'simgen build'.") from None
    except (ValueError, KeyError, TypeError, RecursionError):  # not UTF-8, not JSON, a number of 5000 digits …
        known = False
    if not known:
        raise InputError(f"{path}: not a {DATASET_SCHEMA} file; move the folder away and build it again.")
    return dict(document)


def write_dataset_file(folder: Path | str, header: ShardHeader, shards: list[dict[str, Any]]) -> None:
    """Write dataset.json: `shards` lists {"name", "scenes": [first, end]} of every shard that belongs.

    Raises:
        FileExistsError: there is one, perhaps since a moment ago.
    """
    document = {
        "format": DATASET_SCHEMA,
        "schema": SCHEMA,
        "camera": header.camera.to_json(),
        "depth_unit": header.depth_unit,
        "object": _in_order(header.object.to_json()),
        "config": _in_order(header.config),
        "seed": header.seed,
        "shards": shards,
    }
    write_json(Path(folder) / DATASET_FILE, document, indent=1, new=True)


def _in_order(document: dict[str, Any]) -> Any:
    """The same with its keys in the order in which shards have them, so that wherever it comes from its bytes agree."""
    return json.loads(json.dumps(document, sort_keys=True))


def checksum_problem(path: Path | str) -> str | None:
    """What is wrong with a shard's bytes: None when its SHA-256 agrees with the one it carries."""
    try:
        stated = sha256_stated(path)
        with open(path, "rb") as file:
            file.seek(USER_BLOCK)
            actual = _hash_rest(file)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if stated is None:
        return "carries no checksum: truncated, damaged, or not a shard"
    return None if stated == actual else "its bytes do not match its checksum"


def sha256_stated(path: Path | str) -> str | None:
    """The SHA-256 that a shard carries, unchecked, in hexadecimal; None if it carries none.

    Raises:
        OSError: the file cannot be read.
    """
    with open(path, "rb") as file:
        words = file.read(USER_BLOCK).rstrip(b"\0").split()
    return words[2].decode("ascii", "replace") if len(words) == 3 and words[1] == b"sha256" else None


def seal(path: Path | str, schema: str) -> None:
    """Write the schema and the SHA-256 of all that follows into the user block of a finished, closed file."""
    with open(path, "r+b") as file:
        file.seek(USER_BLOCK)
        digest = _hash_rest(file)
        file.seek(0)
        file.write(f"{schema} sha256 {digest}\n".encode().ljust(USER_BLOCK, b"\0"))


def create_file(path: Path | str) -> Any:
    """A new HDF5 file with room for a checksum, open for writing, whose bytes depend on what is written alone.

    Without a chunk cache, from which chunks would be written when Python lets go of a dataset: later, and so elsewhere
    in the file, where a profiler such as that of Dask's workers holds on to it.
    """
    return h5py.File(path, "w", userblock_size=USER_BLOCK, rdcc_nbytes=0)


def compression_filters(compression: str) -> dict[str, Any]:
    """What h5py's `create_dataset` wants to be told, of one of COMPRESSIONS."""
    return dict(hdf5plugin.Zstd(clevel=1)) if compression == "zstd" else {"compression": "gzip", "compression_opts": 4}


def write_header(file: Any, header: ShardHeader, schema: str, filters: dict[str, Any]) -> None:
    """Write into an open HDF5 file what all its frames share."""
    file.attrs["schema"] = schema
    file.attrs["depth_unit"] = float(header.depth_unit)
    file.attrs["seed"] = int(header.seed)
    for name, value in (
        ("camera", header.camera.to_json()),
        ("object", header.object.to_json()),
        ("config", header.config),
        ("software", header.software),
    ):
        text = json.dumps(value, sort_keys=True)
        file.attrs[name] = text if len(text) < 60_000 else ""  # an attribute holds at most 64 KB
        if len(text) >= 60_000:
            file.create_dataset(f"json/{name}", data=np.frombuffer(text.encode(), np.uint8), **filters)
    if header.object.vertices is not None and header.object.faces is not None:
        write_array(file, "object/vertices", header.object.vertices.astype("<f8"), filters)
        write_array(file, "object/faces", header.object.faces.astype("<i4"), filters)


def write_array(file: Any, name: str, data: NDArray[Any], filters: dict[str, Any]) -> None:
    """Write an array into an open HDF5 file as one checksummed chunk."""
    if data.size == 0:
        file.create_dataset(name, data=data)
        return
    file.create_dataset(name, data=data, chunks=data.shape, fletcher32=True, **filters)


def read_header(file: Any, path: Path | str, schema: str) -> ShardHeader:
    """What :func:`write_header` wrote into an open HDF5 file; `path` names it in errors.

    Raises:
        InputError: it is of another schema, or a part of the header makes no sense.
        OSError, KeyError, JSONDecodeError: a part is damaged or missing.
    """
    found = file.attrs.get("schema")
    if found != schema:
        raise InputError(f"{path}: schema {found!r} where {schema!r} is needed; rebuild it with this simgen.")

    def read_json(name: str) -> Any:
        text = file.attrs[name]
        return json.loads(text if text else file[f"json/{name}"][()].tobytes().decode())

    model = ObjectModel.from_json(read_json("object"), f"{path}: object")
    if "object/vertices" in file:
        model = replace(model, vertices=file["object/vertices"][()], faces=file["object/faces"][()])
    return ShardHeader(
        camera=Camera.from_json(read_json("camera"), f"{path}: camera"),
        depth_unit=float(file.attrs["depth_unit"]),
        object=model,
        config=read_json("config"),
        seed=int(file.attrs["seed"]),
        software=read_json("software"),
    )


def _hash_rest(file: Any) -> str:
    digest = hashlib.sha256()
    while block := file.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def _require_same(first: ShardReader, other: ShardReader) -> None:
    a, b = first.header, other.header
    same = (
        a.camera == b.camera
        and a.depth_unit == b.depth_unit
        and a.object.name == b.object.name
        and abs(a.object.diameter - b.object.diameter) < 1e-9
        and a.object.symmetry.name == b.object.symmetry.name
    )
    if not same:
        raise InputError(
            f"{other.path}: its object, camera or depth unit differs from {first.path}'s; use shards of one build."
        )


def _raise_as_os_error(failure: BaseException | None, path: Path) -> None:
    """On a full disk HDF5 may raise a RuntimeError; raise the OSError that it is. Anything else is left alone."""
    match = re.search(r"errno = (\d+)", str(failure)) if isinstance(failure, RuntimeError) else None
    if match is not None:
        raise OSError(int(match[1]), os.strerror(int(match[1])), str(path)) from failure
