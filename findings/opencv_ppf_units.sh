#!/usr/bin/env bash
# OpenCV contrib's point pair features (ppf_match_3d) find parts or not depending on the unit of the clouds.
#
# opencv-contrib-python-headless 5.0.0.93, numpy 2.2.6, Python 3.10 to 3.12. The same model (an L of 60 x 24 x 48 mm, 1,500
# points with normals) and the same scene (three copies of it, wholly seen, no noise) are given once in millimeters and
# once in meters. Sampling steps are relative to the model, so nothing but the unit differs.
#
# Seen:  millimeters: 93 poses, 3 of 3 parts within 6 mm
#        meters:       6 poses, 0 of 3 parts
#
# Why: matching ends in a clustering of poses whose reach in position is by default the number given as the relative
# sampling step (here 0.05), taken as a length in the cloud's unit and not as a share of the model's size. In meters it
# joins, and averages, poses that are up to 5 cm apart. Python's binding has no call that sets the reach; a depth
# camera's clouds usually come in meters.
# Exits 0 while OpenCV behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "opencv-contrib-python-headless==5.0.0.93" "numpy==2.2.6"
cat > "$folder/units.py" <<'PYTHON'
import sys

import cv2
import numpy as np

BOXES = [((0, 0, 0), (60, 24, 8)), ((0, 0, 8), (8, 24, 40))]  # corner and size, millimeters


def cloud(rng, count=1500):
    """Points and normals on the boxes' faces."""
    faces = [(np.array(c, float), np.array(s, float), axis, side) for c, s in BOXES for axis in range(3) for side in (0, 1)]
    areas = np.array([np.prod(np.delete(size, axis)) for _, size, axis, _ in faces])
    points, normals = [], []
    for number in rng.choice(len(faces), count, p=areas / areas.sum()):
        corner, size, axis, side = faces[number]
        point, normal = corner + size * rng.random(3), np.zeros(3)
        point[axis], normal[axis] = corner[axis] + side * size[axis], 1 if side else -1
        points.append(point)
        normals.append(normal)
    return np.array(points), np.array(normals)


def rotation(axis, angle):
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


PARTS = [
    (rotation((1, 2, 3), 0.7), np.array([0.0, 0.0, 600.0])),
    (rotation((3, -1, 1), 2.0), np.array([90.0, 10.0, 620.0])),
    (rotation((0, 1, 1), 4.0), np.array([20.0, 95.0, 590.0])),
]


def found(unit):
    """How many poses come back, and how many parts one of them lies on within 6 mm; `unit` units are a millimeter."""
    rng = np.random.default_rng(0)
    points, normals = cloud(rng)
    seen = [(p @ turn.T + shift, n @ turn.T) for turn, shift in PARTS for p, n in [cloud(rng)]]
    scene = np.hstack([np.vstack([p for p, _ in seen]) * unit, np.vstack([n for _, n in seen])]).astype(np.float32)
    detector = cv2.ppf_match_3d_PPF3DDetector(0.05, 0.05)
    detector.trainModel(np.hstack([points * unit, normals]).astype(np.float32))
    poses = [np.asarray(result.pose) for result in detector.match(scene, 0.2, 0.05)]
    right = 0
    for turn, shift in PARTS:
        truth = points @ turn.T + shift
        away = [points @ pose[:3, :3].T + pose[:3, 3] / unit - truth for pose in poses]
        right += any(np.sqrt((offset**2).sum(1).mean()) < 6 for offset in away)
    return len(poses), right


millimeters, meters = found(1.0), found(1e-3)
print(f"OpenCV {cv2.__version__}")
print(f"millimeters: {millimeters[0]} poses, {millimeters[1]} of 3 parts")
print(f"meters: {meters[0]} poses, {meters[1]} of 3 parts")
sys.exit(0 if millimeters[1] == 3 and meters[1] == 0 and meters[0] < millimeters[0] / 3 else 1)
PYTHON
"$folder/venv/bin/python" "$folder/units.py" || { echo "The behavior has changed."; exit 1; }
