#!/usr/bin/env bash
# OpenCV divides what it reads from a PFM file by the scale of the file's header, so that disparities or depths written
# by programs that use that number otherwise come out too large by any factor, without a warning.
#
# opencv-python-headless 5.0.0.93, numpy 2.2.6, Python 3.10 to 3.13. A PFM file's third line is one number: its sign says
# the byte order, its size is a scale. Netpbm's page says that it tells the samples' unit and leaves its use open; many
# programs write something else than 1 there (1/255 is common for disparities) and read the samples as they are.
#
# Seen, for disparities 10, 20.5, 40, 80 pixels:
#        scale -1        10, 20.5, 40, 80
#        scale -0.5      20, 41, 80, 160
#        scale -1/255    2550, 5227.5, 10200, 20400
#
# Why it matters: depth = focal length x baseline / disparity, so parts come to lie 255 times too near, or at half their
# distance, which still looks plausible. Depth in meters is read wrong likewise.
# Exits 0 while OpenCV behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "opencv-python-headless==5.0.0.93" "numpy==2.2.6"
cd "$folder"
venv/bin/python - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import sys

import cv2
import numpy as np

disparity = np.array([[10, 20.5], [40, 80]], np.float32)
right = True
print(f"OpenCV {cv2.__version__}")
for name, scale in (("-1", 1.0), ("-0.5", 0.5), ("-1/255", 1 / 255)):
    header = f"Pf\n2 2\n{-scale:.9g}\n".encode()  # negative: little-endian
    with open("disparity.pfm", "wb") as file:
        file.write(header + disparity[::-1].astype("<f4").tobytes())  # rows from the bottom up
    read = cv2.imread("disparity.pfm", cv2.IMREAD_UNCHANGED)
    print(f"scale {name:7}", ", ".join(f"{value:g}" for value in read.ravel()))
    right &= np.allclose(read, disparity / scale, rtol=1e-5)
sys.exit(0 if right else 1)
PYTHON
