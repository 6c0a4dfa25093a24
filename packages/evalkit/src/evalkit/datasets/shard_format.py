"""The dataset on disk: a folder of HDF5 shards, each a fixed range of whole scenes. Schema ``binpose-shard/2``.

Per frame (F = scenes x views)::

    depth (F,H,W uint16)  instance_id (F,H,W uint16)  scene_index (F)  view_index (F)  cam_from_world (F,4,4)
    depth_ideal (F,H,W uint16), where it was kept: depth without the sensor's errors
    frame_offset (F+1)    rows of frame f in the per-instance arrays: frame_offset[f] .. frame_offset[f+1]

Per instance of each frame: the fields of :class:`evalkit.datasets.scene.Instances`. The mesh lies in
``object/vertices`` and ``object/faces``. Attributes: schema, camera, depth_unit, object, config, software (JSON), seed.

Integrity: every chunk carries a Fletcher-32 sum, and the file's first 512 bytes (HDF5's user block, which its readers
skip) hold the SHA-256 of all bytes after them. ``dataset.json`` beside the shards names the config, the object and the
shards that belong to the dataset. Nothing is ever unpickled.

Schema ``binpose-shard/1``, which is read and no longer written, has the returned share alone, as ``visibility``,
``pixels_visible`` and ``box_visible``. Its ``instance_id`` is what it is here, so the geometric share is counted from
the pixels, exactly.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Instances
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

SCHEMA = "binpose-shard/2"
OLD_SCHEMA = "binpose-shard/1"
USER_BLOCK = 512
COMPRESSIONS = ("zstd", "gzip")
INSTANCE_FIELDS = tuple(f.name for f in fields(Instances))
INSTANCE_DTYPES = {
    "instance": "<i4", "cam_from_obj": "<f8", "visibility_geometric": "<f4", "visibility_returned": "<f4",
    "pixels_geometric": "<i4", "pixels_returned": "<i4", "pixels_full": "<i4",
    "box_returned": "<i4", "box_full": "<i4", "center_px": "<f4",
}  # fmt: skip
INSTANCE_SHAPES = {"cam_from_obj": (4, 4), "box_returned": (4,), "box_full": (4,), "center_px": (2,)}
COUNTED_FIELDS = ("visibility_geometric", "pixels_geometric")  # which schema 1 lacks
OLD_NAMES = {
    "visibility_returned": "visibility",
    "pixels_returned": "pixels_visible",
    "box_returned": "box_visible",
}


@dataclass(frozen=True, eq=False)
class ShardHeader:
    """What all frames of a shard share."""

    camera: Camera
    depth_unit: float
    object: ObjectModel
    config: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    software: dict[str, str] = field(default_factory=dict)


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


def read_header(file: Any, path: Path | str, *schemas: str) -> ShardHeader:
    """What :func:`write_header` wrote into an open HDF5 file; `path` names it in errors.

    Args:
        schemas: those that the caller can read, the newest first.

    Raises:
        InputError: it is of another schema, or a part of the header makes no sense.
        OSError, KeyError, JSONDecodeError: a part is damaged or missing.
    """
    found = file.attrs.get("schema")
    if found not in schemas:
        raise InputError(f"{path}: schema {found!r} where {schemas[0]!r} is needed; rebuild it with this simgen.")

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
