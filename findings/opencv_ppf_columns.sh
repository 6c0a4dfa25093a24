#!/usr/bin/env bash
# OpenCV contrib's loadPLYSimple takes a PLY file's columns by their position, whatever the header calls them: a cloud
# with a column more comes out as other points, without a warning.
#
# opencv-contrib-python-headless 5.0.0.93, numpy 2.2.6, Python 3.10 to 3.13. It is the reader of the surface matching
# (ppf_match_3d) samples. OpenCV's own loadPointCloud reads the same files rightly.
#
# Seen, for two points (1, 2, 3) and (4, 5, 6), normals (0, 0, 1) and (0, 1, 0):
#        x y z nx ny nz                      as they are
#        x y z red green blue nx ny nz       the colors, scaled to length 1, are the normals
#        x y z quality nx ny nz              second point (1, 4, 5): its first number is the end of the line before
#
# Why it matters: MeshLab writes a quality column, scanners write colors before normals. Point pair features live on
# normals; a model or a scene with false ones is matched, and finds nothing or the wrong pose.
# Exits 0 while OpenCV behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "opencv-contrib-python-headless==5.0.0.93" "numpy==2.2.6"
cd "$folder"
venv/bin/python - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import sys

import cv2
import numpy as np

FILES = {
    "plain": ("", "", np.array([[1, 2, 3, 0, 0, 1], [4, 5, 6, 0, 1, 0]])),
    "colors": ("red green blue", "90 120 200", np.array([[1, 2, 3, 0.36, 0.48, 0.8], [4, 5, 6, 0.36, 0.48, 0.8]])),
    "quality": ("quality", "7", None),
}
right = True
print("OpenCV", cv2.__version__)
for name, (columns, values, expected) in FILES.items():
    properties = [f"property float {axis}" for axis in "xyz"]
    properties += [f"property {'float' if name == 'quality' else 'uchar'} {column}" for column in columns.split()]
    properties += [f"property float n{axis}" for axis in "xyz"]
    rows = [f"1 2 3 {values} 0 0 1", f"4 5 6 {values} 0 1 0"]
    with open(f"{name}.ply", "w") as file:
        file.write("\n".join(["ply", "format ascii 1.0", "element vertex 2", *properties, "end_header", *rows, ""]))
    read = cv2.ppf_match_3d.loadPLYSimple(f"{name}.ply", 1)
    vertices, normals, _ = cv2.loadPointCloud(f"{name}.ply")
    other = np.hstack([np.reshape(vertices, (-1, 3)), np.reshape(normals, (-1, 3))])
    print(f"{name:8}", *(np.round(row, 2).tolist() for row in read))
    right &= np.array_equal(other, FILES["plain"][2])
    right &= np.allclose(read, expected, atol=0.02) if expected is not None else np.allclose(read[1, :3], (1, 4, 5))
sys.exit(0 if right else 1)
PYTHON
