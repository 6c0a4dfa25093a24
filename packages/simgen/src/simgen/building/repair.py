"""A damaged dataset made whole again, from nothing but itself: its config, and the mesh that any shard of it holds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evalkit.datasets.shard_folder import DATASET_FILE, read_dataset_file
from evalkit.datasets.shard_format import ShardHeader, checksum_problem
from evalkit.datasets.shard_reader import ShardReader
from evalkit.errors import InputError
from simgen.building.build import BuildReport, build
from simgen.config_json import config_from_json
from simgen.objects.convex import convex_parts
from simgen.scenes.job import Job
from simgen.scenes.software import software_here

AGAIN = "run the command again that it was built with, which rebuilds what is damaged or missing"


def repair(folder: Path, workers: int) -> tuple[BuildReport, list[str]]:
    """Rebuild the shards of a folder that are damaged or missing; returns what was done, and warnings.

    Raises:
        InputError: the folder alone does not say how, the physics here would make other piles, or another build is at
            work in it.
        OSError: the folder cannot be written.
    """
    job, header = job_of_dataset(folder)
    here = software_here(job.config.physics.engine)
    warnings = [
        f"{name} {header.software.get(name, '(none)')} made the dataset, {here.get(name, '(none)')} is here: "
        "repaired shards may differ from what they were."
        for name in sorted(here.keys() | header.software.keys())
        if header.software.get(name) != here.get(name)
    ]
    return build(job, folder, workers), warnings


def job_of_dataset(folder: Path) -> tuple[Job, ShardHeader]:
    """The job that a folder of shards was built by, and the header of one of them.

    The object comes from any shard that can be read, an intact one if there is one: with the convex parts computed
    anew, it must have the geometry that the config states.

    Raises:
        InputError: the scenes came from elsewhere, no shard can be read, or the geometry is another.
    """
    document = read_dataset_file(folder)
    where = f"{folder / DATASET_FILE}: config"
    config = config_from_json(document.get("config"), where)
    if "layouts" in document["config"] or config.bin is None:
        raise InputError(f"{folder}: its scenes were not simulated here; {AGAIN}.")
    tried = False
    for header in _headers(folder):
        vertices, faces = header.object.vertices, header.object.faces
        if vertices is None or faces is None:
            continue
        tried = True
        parts, _ = convex_parts(vertices, faces.astype("int64"))
        job = Job(config, header.object, parts, header.depth_unit)
        if job.header.config == document["config"]:
            return job, header
    raise InputError(
        f"{folder}: its object's convex parts come out differently here than where it was built; {AGAIN}."
        if tried
        else f"{folder}: no shard is left to read the object from; {AGAIN}."
    )


def _headers(folder: Path) -> Iterator[ShardHeader]:
    """The headers of all shards that can be read, those of intact ones first."""
    paths = sorted(folder.glob("shard-*.h5"))
    for intact in (True, False):
        for path in paths:
            if (checksum_problem(path) is None) != intact:
                continue
            try:
                with ShardReader(path) as reader:
                    yield reader.header
            except InputError:
                continue
