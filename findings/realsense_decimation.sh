#!/usr/bin/env bash
# RealSense: the decimation filter moves a surface sideways by up to one pixel of the large image, by how much depends on
# the side that the surface is inclined to. No camera is needed, librealsense's software device takes the depth image.
#
# pyrealsense2 2.59.1.11053, numpy 2.2.6, Python 3.10 to 3.13. Of the four pixels that become one the filter keeps the
# second smallest depth, and it halves the principal point. librealsense counts pixels from their middle (x = (u - ppx) /
# fx z), so a pixel made of columns 2u and 2u + 1 lies at 2u + 1/2, and the principal point should go from p to
# (p - 1/2) / 2. As it is, the ray is that of column 2u: right where depth grows with u, and where it shrinks the depth is
# column 2u + 1's.
#
# Seen:  ppx 31.5 becomes 15.75, where (31.5 - 0.5) / 2 = 15.5
#        planes z = 1 m + x and z = 1 m - x, mean distance of the points from the plane they should lie on:
#        large image  -0.03 and -0.03 mm;  decimated by 2  -0.01 and -13.01 mm (fx is 60 pixels)
#
# Why it matters: of two flanks of one part one stays and the other moves by z / fx of the large image, 1.3 mm at 0.8 m
# where fx is 610 pixels. It is a bias: ICP fits it, and no averaging removes it.
# Exits 0 while librealsense behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pyrealsense2==2.59.1.11053" "numpy==2.2.6"
"$folder/venv/bin/python" - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import sys

import numpy as np
import pyrealsense2 as rs

WIDTH, HEIGHT, FOCAL, MIDDLE = 64, 48, 60.0, (31.5, 23.5)
camera = rs.intrinsics()
camera.width, camera.height, camera.fx, camera.fy, (camera.ppx, camera.ppy) = WIDTH, HEIGHT, FOCAL, FOCAL, MIDDLE
stream = rs.video_stream()
stream.type, stream.fmt, stream.width, stream.height, stream.fps, stream.bpp = (
    rs.stream.depth, rs.format.z16, WIDTH, HEIGHT, 30, 2)  # fmt: skip
stream.intrinsics = camera
device = rs.software_device()
sensor = device.add_sensor("Depth")
profile = sensor.add_video_stream(stream)
queue = rs.syncer()
sensor.open(profile)
sensor.start(queue)
decimation = rs.decimation_filter()
decimation.set_option(rs.option.filter_magnitude, 2)


def off_plane(depth, slope):
    """Millimeters between the points of a depth frame and the plane z = 1 m + slope x, along its normal, on average."""
    points = np.array(rs.pointcloud().calculate(depth).get_vertices()).view(np.float32).reshape(-1, 3)
    points = points[points[:, 2] > 0]
    return float(1000 * (points[:, 2] - slope * points[:, 0] - 1).mean() / np.sqrt(1 + slope**2))


off = {}
for number, slope in enumerate((1.0, -1.0), 1):
    z = 1000 / (1 - slope * (np.arange(WIDTH) - MIDDLE[0]) / FOCAL)
    frame = rs.software_video_frame()
    frame.pixels = np.tile(np.round(z).astype(np.uint16), (HEIGHT, 1))
    frame.stride, frame.bpp, frame.depth_units = 2 * WIDTH, 2, 0.001
    frame.timestamp, frame.frame_number, frame.profile = float(number), number, profile.as_video_stream_profile()
    sensor.on_video_frame(frame)
    large = queue.wait_for_frames(5000).get_depth_frame()
    small = decimation.process(large).as_depth_frame()
    off[slope] = off_plane(large, slope), off_plane(small, slope)
    print(f"z = 1 m {'+' if slope > 0 else '-'} x, off the plane: large {off[slope][0]:+.2f} mm, decimated {off[slope][1]:+.2f} mm")
stated = small.profile.as_video_stream_profile().intrinsics
print(f"ppx {camera.ppx} becomes {stated.ppx}, where (ppx - 0.5) / 2 = {(camera.ppx - 0.5) / 2}")
whole = max(abs(off[1.0][0]), abs(off[-1.0][0]), abs(off[1.0][1])) < 0.5
sys.exit(0 if stated.ppx == camera.ppx / 2 and whole and abs(off[-1.0][1]) > 5 else 1)
PYTHON
