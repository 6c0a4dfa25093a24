"""Simulated scenes as one small file, that whoever renders them needs. Schema ``binpose-scenes/1``.

HDF5, with the attributes and the mesh of a shard (:mod:`evalkit.datasets.shard_format`), and per scene (S)::

    instances (S)  attempts (S): drops that it took

and per instance of all scenes, one after the other (N)::

    translation (N,3)  quaternion_xyzw (N,4)  correction (N,3,3 int64)

Of world_from_obj, in meters. A rotation's nine numbers are those of its quaternion, each moved by `correction` steps
of float64: mostly a few units in the last place. So a pose takes 60 bytes and comes back to the last bit.

Cameras are not stored: the config says how they are drawn. The SHA-256 is where a shard has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.datasets.shard_format import (
    ShardHeader,
    checksum_problem,
    create_file,
    read_header,
    seal,
    write_array,
    write_header,
)
from evalkit.errors import InputError
from evalkit.geometry import poses
from simgen.config_json import config_from_json
from simgen.scenes.job import Job
from simgen.scenes.recorded import RecordedScenes
from simgen.scenes.software import only_physics

SCHEMA = "binpose-scenes/1"
GEOMETRY = "geometry_sha256"
AGAIN = "delete it and run 'simgen simulate' again"
_FILTERS: dict[str, Any] = {**hdf5plugin.Zstd(clevel=9), "shuffle": True}
Array = NDArray[np.float64]


def write_scenes(path: Path, header: ShardHeader, world_from_obj: Sequence[Array], attempts: Sequence[int]) -> None:
    """Write the poses (n_s, 4, 4) of each of a dataset's scenes; the file appears when complete.

    Raises:
        OSError: the file cannot be written.
    """
    every = np.concatenate([np.zeros((0, 4, 4)), *world_from_obj])
    quaternion = poses.to_quaternion_xyzw(every[:, :3, :3])
    with atomic_path(path) as temporary:
        with create_file(temporary) as file:
            write_header(file, header, SCHEMA, _FILTERS)
            write_array(file, "instances", np.array([len(scene) for scene in world_from_obj], "<i4"), _FILTERS)
            write_array(file, "attempts", np.array(attempts, "<i4"), _FILTERS)
            write_array(file, "translation", every[:, :3, 3].astype("<f8"), _FILTERS)
            write_array(file, "quaternion_xyzw", quaternion.astype("<f8"), _FILTERS)
            correction = _steps(every[:, :3, :3]) - _steps(poses.from_quaternion_xyzw(quaternion))
            write_array(file, "correction", correction.astype("<i8"), _FILTERS)
        seal(temporary, SCHEMA)


def read_scenes(path: Path) -> tuple[ShardHeader, RecordedScenes]:
    """The header of a scenes file, and its scenes.

    Raises:
        InputError: the file is missing, damaged, or no scenes file; the sentence names it and the mend.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such scenes file; make one with 'simgen simulate -o {path}'.")
    problem = checksum_problem(path)
    try:
        with h5py.File(path, "r") as file:
            schema = file.attrs.get("schema")
            if schema != SCHEMA:
                raise InputError(f"{path}: its schema is {schema!r}, not {SCHEMA!r}; give a file of 'simgen simulate'.")
            if problem is not None:
                raise InputError(f"{path}: {problem}; {AGAIN}.")
            header = read_header(file, path, SCHEMA)
            return header, _read_poses(file, header)
    except OSError:
        raise InputError(
            f"{path}: not a readable HDF5 file; give a file of 'simgen simulate', or {AGAIN} if it was one."
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged or incomplete ({error}); {AGAIN}.") from None


def job_of_scenes(path: Path) -> Job:
    """The job that renders a scenes file as the config in it says.

    Raises:
        InputError: as :func:`read_scenes`; or its config is not one of this version.
    """
    header, recorded = read_scenes(path)
    config = config_from_json(header.config, f"{path}: config")
    if config.bin is None or header.object.vertices is None:
        raise InputError(f"{path}: lacks the bin or the mesh; {AGAIN}.")
    if config.scenes != len(recorded.world_from_obj):
        raise InputError(f"{path}: holds {len(recorded.world_from_obj)} of {config.scenes} scenes; {AGAIN}.")
    return Job(config, header.object, [], header.depth_unit, recorded)


def _read_poses(file: Any, header: ShardHeader) -> RecordedScenes:
    """Raises KeyError or ValueError where the arrays do not fit together."""
    instances, attempts = file["instances"][()], file["attempts"][()]
    total = int(instances.sum())
    quaternion, translation = file["quaternion_xyzw"][()], file["translation"][()]
    correction = file["correction"][()]
    shapes = (len(attempts), quaternion.shape, translation.shape, correction.shape)
    if shapes != (len(instances), (total, 4), (total, 3), (total, 3, 3)) or (instances < 1).any():
        raise ValueError("its arrays do not fit together")
    rotation = (_steps(poses.from_quaternion_xyzw(quaternion)) + correction).view(np.float64)
    world_from_obj = poses.from_rotation_translation(rotation, translation)
    if not (np.isfinite(world_from_obj).all() and poses.is_rotation(rotation).all()):
        raise ValueError("its poses are not rigid")
    return RecordedScenes(
        first=0,
        world_from_obj=np.split(world_from_obj, np.cumsum(instances)[:-1]),
        attempts=attempts.tolist(),
        origin={GEOMETRY: header.config[GEOMETRY]},
        software=only_physics(header.software),
    )


def _steps(numbers: Array) -> NDArray[np.int64]:
    """The bits of float64 numbers: neighbors of one sign differ by one."""
    return np.ascontiguousarray(numbers, np.float64).view(np.int64)
