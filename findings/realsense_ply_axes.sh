#!/usr/bin/env bash
# RealSense: the point cloud that export_to_ply writes is not the one in memory: y and z are turned around. No camera is
# needed, librealsense's software device takes the depth image.
#
# pyrealsense2 2.59.1.11053, numpy 2.2.6, Python 3.10 to 3.13. A wall 0.5 m ahead, its upper half 0.1 m nearer.
#
# Seen:  in memory       z from 0.400 to 0.500, nearest point above the axis: y < 0 (OpenCV's camera axes, y down)
#        in the PLY file z from -0.500 to -0.400, nearest point at y > 0
#
# Why it matters: a pose found on the file's cloud is turned by half a turn about x against one found on the depth image
# or on the points in memory: robot and part are then on opposite sides of the camera. Nothing in the file says so; its
# comment is "pointcloud saved from Realsense Viewer".
# Exits 0 while librealsense behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pyrealsense2==2.59.1.11053" "numpy==2.2.6" "plyfile==1.1.3"
cd "$folder"
venv/bin/python - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import sys

import numpy as np
import plyfile
import pyrealsense2 as rs

WIDTH, HEIGHT = 64, 48
camera = rs.intrinsics()
camera.width, camera.height, camera.fx, camera.fy, camera.ppx, camera.ppy = WIDTH, HEIGHT, 60.0, 60.0, 31.5, 23.5
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

depth = np.full((HEIGHT, WIDTH), 500, np.uint16)
depth[: HEIGHT // 2] = 400
frame = rs.software_video_frame()
frame.pixels, frame.stride, frame.bpp, frame.depth_units = depth, 2 * WIDTH, 2, 0.001
frame.timestamp, frame.frame_number, frame.profile = 1.0, 1, profile.as_video_stream_profile()
sensor.on_video_frame(frame)
depth_frame = queue.wait_for_frames(5000).get_depth_frame()

points = rs.pointcloud().calculate(depth_frame)
memory = np.array(points.get_vertices()).view(np.float32).reshape(-1, 3)
points.export_to_ply("cloud.ply", depth_frame)
vertex = plyfile.PlyData.read("cloud.ply")["vertex"]
written = np.stack([vertex[axis] for axis in "xyz"], -1)


def told(name, cloud):
    nearest = cloud[np.abs(cloud[:, 2]).argmin()]
    print(f"{name:15} z from {cloud[:, 2].min():.3f} to {cloud[:, 2].max():.3f}, nearest at y = {nearest[1]:+.3f}")


told("in memory", memory)
told("in the PLY file", written)
turned = memory * [1, -1, -1]
same = len(memory) == len(written) and np.allclose(np.sort(turned, 0), np.sort(written, 0), atol=1e-5)
sys.exit(0 if same and memory[:, 2].min() > 0 else 1)
PYTHON
