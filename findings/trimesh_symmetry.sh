#!/usr/bin/env bash
# trimesh's Trimesh.symmetry calls parts symmetric about an axis, or about a point, that are not: it compares principal
# moments of inertia and nothing else.
#
# trimesh 5.2.0, numpy 2.2.6, scipy 1.15.3, Python 3.10 to 3.13. The documentation: "Check whether a mesh has rotational
# symmetry around an axis (radial) or point (spherical)". Whatever turns onto itself by a third of a turn or less has two
# equal moments, and of a cube all three are equal.
#
# Seen (share of the surface that turning by 30 degrees about that axis takes farther away than 2 % of the diameter):
#        square bar      radial       51 %
#        three-cornered  radial       50 %
#        hexagonal nut   radial       27 %
#        cube            spherical    55 %
#
# Why it matters: whoever takes the answer as the object's symmetry for training, for ICP or for a score (a revolution
# axis for BOP's models_info.json) declares every turn of a hexagonal nut equal, and grippers close on its corners.
# Exits 0 while trimesh behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "trimesh==5.2.0" "numpy==2.2.6" "scipy==1.15.3" networkx
"$folder/venv/bin/python" - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import sys

import numpy as np
import trimesh
from scipy.spatial import cKDTree

PARTS = {
    "square bar": (trimesh.creation.box((20, 20, 60)), "radial"),
    "three-cornered": (trimesh.creation.cylinder(20, 10, sections=3), "radial"),
    "hexagonal nut": (trimesh.creation.cylinder(10, 8, sections=6), "radial"),
    "cube": (trimesh.creation.box((20, 20, 20)), "spherical"),
}
right = True
print("trimesh", trimesh.__version__)
for name, (mesh, expected) in PARTS.items():
    points = mesh.sample(20_000, seed=0)
    turn = trimesh.transformations.rotation_matrix(np.radians(30), mesh.symmetry_axis, mesh.center_mass)
    away = cKDTree(points).query(trimesh.transform_points(mesh.sample(4_000, seed=1), turn))[0]
    share = np.mean(away > 0.02 * np.linalg.norm(mesh.extents))
    print(f"{name:15} {mesh.symmetry:10} {share:.0%} of the surface elsewhere after 30 degrees")
    right &= mesh.symmetry == expected and share > 0.1
sys.exit(0 if right else 1)
PYTHON
