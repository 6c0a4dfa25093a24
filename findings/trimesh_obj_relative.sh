#!/usr/bin/env bash
# trimesh reads Wavefront OBJ files with relative (negative) vertex numbers wrongly where faces stand between vertices:
# bodies vanish and others are there twice, without a warning.
#
# trimesh 5.2.0, numpy 2.2.6, Python 3.10 to 3.13. The format counts -1 as the vertex read last before the face's line, so
# that a writer can put out body after body without keeping count. trimesh counts from the last vertex of the whole file.
#
# Seen, for a file of a box of 6000 mm3 and another of 1 mm3, 50 mm away, each with its faces behind its vertices:
#        volume 2 instead of 6001, size 1 x 1 x 1 instead of 55.5 x 20 x 30 mm
#
# Why it matters: the part that is trained on, simulated or matched is not the part in the file, and it is a sound,
# closed mesh, which no check of the mesh alone will doubt.
# Exits 0 while trimesh behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "trimesh==5.2.0" "numpy==2.2.6"
cd "$folder"
venv/bin/python - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import sys

import numpy as np
import trimesh

big, small = trimesh.creation.box((10, 20, 30)), trimesh.creation.box((1, 1, 1))
small.apply_translation((50, 0, 0))
lines = {"absolute.obj": [], "relative.obj": []}
read = 0
for body in (big, small):
    vertices = [f"v {x} {y} {z}" for x, y, z in body.vertices]
    lines["absolute.obj"] += vertices + [f"f {a} {b} {c}" for a, b, c in body.faces + read + 1]
    lines["relative.obj"] += vertices + [f"f {a} {b} {c}" for a, b, c in body.faces - len(vertices)]
    read += len(vertices)

volume = {}
print("trimesh", trimesh.__version__)
for name, text in lines.items():
    with open(name, "w") as file:
        file.write("\n".join(text) + "\n")
    mesh = trimesh.load_mesh(name, process=False)
    used = mesh.vertices[np.unique(mesh.faces)]
    volume[name] = round(float(mesh.volume))
    print(f"{name}: volume {volume[name]}, size {' x '.join(f'{side:g}' for side in np.ptp(used, axis=0))}")
sys.exit(0 if volume == {"absolute.obj": 6001, "relative.obj": 2} else 1)
PYTHON
