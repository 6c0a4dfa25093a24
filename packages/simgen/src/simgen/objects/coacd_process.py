"""CoACD in a process of its own: it prints from C++, cannot be interrupted, and may crash on a bad mesh.

``python -m simgen.objects.coacd_process MESH.npz PARTS.npz OPTIONS_JSON`` reads vertices (V, 3) and faces (F, 3), and
writes vertices_0, faces_0, vertices_1, … of the convex parts. It imports nothing that would keep the caller waiting.
"""

from __future__ import annotations

import json
import resource
import sys
from typing import Any

import coacd
import numpy as np

CPU_LIMIT_S = 7200  # only against running on for ever: the caller then refuses the mesh, whatever the machine


def main(mesh_file: str, parts_file: str, options: str) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S + 10))
    with np.load(mesh_file, allow_pickle=False) as archive:
        mesh = coacd.Mesh(archive["vertices"], archive["faces"])
    coacd.set_log_level("off")
    arrays: dict[str, Any] = {}
    for i, (vertices, faces) in enumerate(coacd.run_coacd(mesh, **json.loads(options))):
        arrays[f"vertices_{i}"], arrays[f"faces_{i}"] = np.asarray(vertices, float), np.asarray(faces, np.int32)
    np.savez(parts_file, **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
