"""A small dataset of an angle of two boxes, which several tests build."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry
from simgen.config import BuildConfig
from simgen.presets import debug, default_camera
from simgen.scenes.job import Job
from simgen.scenes.plan import plan

SMALL = replace(debug(), scenes=5, views=2, instances_min=2, instances_max=4, camera=default_camera(80, 60))


def job_of(config: BuildConfig = SMALL, symmetry: str = "none", scale: float = 1.0) -> Job:
    arms = [trimesh.creation.box([0.08, 0.03, 0.01]), trimesh.creation.box([0.01, 0.03, 0.06])]
    parts = [(np.asarray(arm.vertices) * scale, np.asarray(arm.faces)) for arm in arms]
    vertices = np.vstack([part[0] for part in parts])
    faces = np.vstack([parts[0][1], parts[1][1] + len(parts[0][0])])
    return plan(config, ObjectModel.from_mesh("angle", vertices, faces, Symmetry.parse(symmetry)), parts)


def digests(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir()) if path.is_file()
    }


def times(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("shard-*.h5")}
