"""The same bytes on every processor: BLAS has other kernels for each, whose sums differ in the last bits."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

KERNELS = ("Haswell", "SkylakeX", "Prescott")
BUILD = """
import hashlib, json, sys
from pathlib import Path
import numpy as np
import trimesh
from angle_job import SMALL, digests, job_of
from dataclasses import replace
from evalkit.geometry import poses
from evalkit.objects.symmetry_detection import resolve_symmetry
from simgen.building.build import build_shard
from simgen.objects.hulls import simplified_hull
from simgen.scenes.job import Job
from simgen.scenes.plan import plan

folder = Path(sys.argv[1])
folder.mkdir()
job = job_of(replace(SMALL, scenes=2, shard_scenes=2))
round_body = simplified_hull(np.random.default_rng(0).normal(size=(400, 3)) @ np.diag([0.02, 0.01, 0.01]), 2e-3)
found = resolve_symmetry(*job.model.mesh, "auto")
bar = trimesh.creation.box([0.08, 0.03, 0.02]).subdivide().subdivide()
turn = poses.from_axis_angle([1, 2, 3], 0.7)
aslant = resolve_symmetry(poses.compose(bar.vertices, turn), bar.faces, "auto")
assert aslant.symmetry.name == "dihedral:2"
build_shard(job, folder, 0)
rough = poses.random_rotations(np.random.default_rng(1), 50) + np.random.default_rng(2).normal(0, 1e-3, (50, 3, 3))
print(hashlib.sha256(poses.nearest_rotation(rough).tobytes()).hexdigest())
print(hashlib.sha256(round_body.tobytes()).hexdigest(), json.dumps(found.symmetry.to_json()), digests(folder))
print(json.dumps(aslant.symmetry.to_json()), repr(aslant.residual))
"""


def test_the_processors_kernels_do_not_show(tmp_path: Path) -> None:
    """From hulls and symmetry to a shard, by the kernels of three kinds of processors."""
    processes = {}
    for kernel in KERNELS:
        variables = os.environ | {"OPENBLAS_CORETYPE": kernel, "PYTHONPATH": str(Path(__file__).parent)}
        command = [sys.executable, "-c", BUILD, str(tmp_path / kernel)]
        processes[kernel] = subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True)
    printed = {kernel: process.communicate()[0] for kernel, process in processes.items()}
    able = [kernel for kernel, process in processes.items() if process.returncode != -signal.SIGILL]
    assert len(able) >= 2
    assert all(processes[kernel].returncode == 0 for kernel in able)
    assert len({printed[kernel] for kernel in able}) == 1
