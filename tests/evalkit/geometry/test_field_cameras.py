"""Camera files as programs and datasets in the field write them: read right, or refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from evalkit.commands.camera_command import camera as camera_command
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_files import read_camera

CAMERA = Camera(640, 480, 600, 601, 320.5, 240.25)
ROWS = [[600.0, 0.0, 320.5], [0.0, 601.0, 240.25], [0.0, 0.0, 1.0]]
COLUMNS = np.transpose(ROWS).tolist()
FLAT, FLAT_COLUMNS = np.ravel(ROWS).tolist(), np.ravel(COLUMNS).tolist()
SIZE = {"width": 640, "height": 480}
NAMED = {"fx": 600.0, "fy": 601.0, "cx": 320.5, "cy": 240.25}
COLOR = {"width": 1920, "height": 1080, "fx": 1400.0, "fy": 1400.0, "cx": 960.0, "cy": 540.0}
BENT = [-0.3, 0.1, 0.001, -0.001, 0.02]

ROS2 = """header:
  stamp:
    sec: 3
    nanosec: 7
  frame_id: camera_depth_optical_frame
height: 480
width: 640
distortion_model: plumb_bob
d:
- 0.0
- 1.0e-12
- -2e-13
- 0.0
- 0.0
k:
- 600.0
- 0.0
- 320.5
- 0.0
- 601.0
- 240.25
- 0.0
- 0.0
- 1.0
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""
OST = """# oST version 5.0 parameters


[image]

width
640

height
480

[narrow_stereo]

camera matrix
600.000000 0.000000 320.500000
0.000000 601.000000 240.250000
0.000000 0.000000 1.000000

distortion
%s

rectification
1.000000 0.000000 0.000000
0.000000 1.000000 0.000000
0.000000 0.000000 1.000000

projection
590.000000 0.000000 321.000000 0.000000
0.000000 590.000000 241.000000 0.000000
0.000000 0.000000 1.000000 0.000000

"""
REALSENSE = """Device info:
    Name                          :     Intel RealSense D435
 Intrinsic of "%s" / %s / {Z16}
  Width:      \t640
  Height:     \t480
  PPX:        \t320.5
  PPY:        \t240.25
  Fx:         \t600
  Fy:         \t601
  Distortion: \tBrown Conrady
  Coeffs:     \t0  \t0  \t0  \t0  \t0  \t
  FOV (deg):  \t56.1 x 43.6

Extrinsic from "Depth"\t  To\t  "Color" :
 Rotation Matrix:
   0.999749        -0.021599      0.0059
"""
ORBBEC = """[ColorIntrinsic]
fx=1400
fy=1400
cx=960
cy=540
width=1920
height=1080

[DepthIntrinsic]
fx=600
fy=601
cx=320.5
cy=240.25
width=640
height=480

[DepthDistort]
k1=-0.3
k2=0.1
p1=0.001
p2=-0.001
k3=0.02

[D2CTransformParam]
rot0=0.99
"""
HALCON = """# INTERNAL CAMERA PARAMETERS

ParGroup: Cam: Par
"Internal CCD-camera parameters";

Focus:foc: 0.006;
    DOUBLE:0.0:;
    "Focal length of the lens [meter]";

Kappa:kappa: %s;
    DOUBLE::;

Sx:sx: 1.0e-05;
    DOUBLE:0.0:;

Sy:sy: 9.98336106e-06;
    DOUBLE:0.0:;

Cx:cx: 320.5;

Cy:cy: 240.25;

ImageWidth:imgw: 640;

ImageHeight:imgh: 480;
"""
MATLAB = {
    "RadialDistortion": [0, 0], "TangentialDistortion": [0, 0], "ImageSize": [480, 640], "Skew": 0,
    "IntrinsicMatrix": [[600.0, 0, 0], [0, 601.0, 0], [321.5, 241.25, 1]], "FocalLength": [600.0, 601.0],
    "PrincipalPoint": [321.5, 241.25], "WorldUnits": "mm",
}  # fmt: skip
TRAJECTORY = {
    "class_name": "PinholeCameraTrajectory",
    "parameters": [
        {"class_name": "PinholeCameraParameters", "extrinsic": [1.0] * 16}
        | {"intrinsic": SIZE | {"intrinsic_matrix": FLAT_COLUMNS}}
    ]
    * 3,
}
NERF = SIZE | {"frames": [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}]}
NERF |= {"w": 640, "h": 480, "fl_x": 600.0, "fl_y": 601.0, "cx": 321.0, "cy": 240.75, "camera_model": "OPENCV"}
RECTIFIED = {"rectified.0.fx": "600", "rectified.0.fy": "601", "rectified.0.ppx": "320.5", "rectified.0.ppy": "240.25"}
RECTIFIED |= {"rectified.0.width": "640", "rectified.0.height": "480", "baseline": "-50.0", "rectified.9.width": "0"}

READ = {
    "ros2.yaml": ROS2,
    "topic.txt": ROS2,
    "two messages.yaml": ROS2 + ROS2.replace("sec: 3", "sec: 4"),
    "ost.txt": OST % "0.0 0.0 0.0 0.0 0.0",
    "ost.ini": OST % "0.0 0.0 0.0 0.0 0.0",
    "typed_arrays.json": json.dumps(SIZE | {"K": {str(i): v for i, v in enumerate(FLAT)}, "D": {}, "P": None}),
    "rs.txt": REALSENSE % ("Depth", "640x480"),
    "old rs.txt": (REALSENSE % ("Depth", "640x480")).replace(" / 640x480 / {Z16}", "      640x480         Z16"),
    "printed.txt": "[ 640x480  p[320.5 240.25]  f[600 601]  Brown Conrady [0 0 0 0 0] ]",
    "printed 2.txt": "width: 640, height: 480, ppx: 320.5, ppy: 240.25, fx: 600, fy: 601, model: Brown Conrady, "
    "coeffs: [0, 0, 0, 0, 0]",
    "rectified.json": json.dumps(RECTIFIED),
    "words.json": json.dumps(SIZE | {"focal_length": {"x": 600.0, "y": 601.0}, "principal_point": [320.5, 240.25]}),
    "resolution.json": json.dumps(NAMED | {"resolution": "640x480"}),
    "resolution2.json": json.dumps(NAMED | {"image_size": SIZE}),
    "halcon.dat": HALCON % "0.0",
    "matlab.json": json.dumps(MATLAB),
    "by_columns.json": json.dumps(SIZE | {"K": FLAT_COLUMNS}),
    "nested columns.json": json.dumps(SIZE | {"Camera": COLUMNS}),
    "four_by_four.json": json.dumps(SIZE | {"K": [[*row, 0.0] for row in ROWS] + [[0, 0, 0, 1]]}),
    "trajectory.json": json.dumps(TRAJECTORY),
    "transforms.json": json.dumps(NERF),
    "nvisii.json": json.dumps({"camera_data": SIZE | {"intrinsics": NAMED}, "objects": [{"class": "a"}]}),
    "ndds.json": json.dumps(
        {"camera_settings": [{"name": "Viewpoint", "intrinsic_settings": NAMED | {"resX": 640, "resY": 480, "s": 0}}]}
    ),
    "oak.json": json.dumps(
        {"cameraData": [[2, SIZE | {"cameraType": 0, "distortionCoeff": [0.0] * 14, "intrinsicMatrix": ROWS}]]}
    ),
    "ensenso.json": json.dumps({"Calibration": {"Camera": COLUMNS, "Distortion": [0.0] * 5} | SIZE}),
    "python.yaml": "image_size: !!python/tuple\n- 640\n- 480\n" + f"camera_matrix: {ROWS}\ndist_coeff: [[0.0, 0.0]]\n",
    "equals.txt": "fx = 600\nfy = 601\ncx=320.5\ncy=240.25\nwidth=640\nheight=480\n",
    "header.csv": "width,height,fx,fy,cx,cy\n640,480,600,601,320.5,240.25\n",
    "arkitscenes.pincam": "640 480 600 601 320.5 240.25\n",
    "six.txt": "600 601 320.5 240.25 640 480\n",
    "powershell.txt": (REALSENSE % ("Depth", "640x480")).encode("utf-16"),
    "scannet.txt": "depthWidth = 640\ndepthHeight = 480\nfx_depth = 600\nfy_depth = 601\nmx_depth = 320.5\n"
    "my_depth = 240.25\nsceneType = Bathroom\n",
    "sixd info.yml": "width: 640\nheight: 480\ncam_K: [600.0, 0, 320.5, 0, 601.0, 240.25, 0, 0, 1]\ndepth_scale: 1.0\n",
}  # fmt: skip


def write(folder: Path, name: str, text: str | bytes) -> Path:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / name


@pytest.mark.parametrize("name", READ)
def test_what_the_field_writes_is_read(tmp_path: Path, name: str) -> None:
    found = read_camera(write(tmp_path, name, READ[name]))
    numbers = (found.camera.fx, found.camera.fy, found.camera.cx, found.camera.cy)
    assert (found.camera.width, found.camera.height) == (640, 480)
    assert numbers == pytest.approx((600, 601, 320.5, 240.25))
    assert found.lens is None


SIZELESS = {
    "four.txt": "600 601 320.5 240.25\n",
    "four.csv": "fx,fy,cx,cy\n600,601,320.5,240.25\n",
    "printed numpy.txt": "[[600.     0.   320.5 ]\n [  0.   601.   240.25]\n [  0.     0.     1.  ]]\n",
    "intrinsic_depth.txt": "600 0 320.5 0\n0 601 240.25 0\n0 0 1 0\n0 0 0 1\n",
    "list.json": json.dumps([600.0, 601.0, 320.5, 240.25]),
    "record3d.json": json.dumps({"K": FLAT_COLUMNS, "fps": 60}),
}


@pytest.mark.parametrize("name", SIZELESS)
def test_numbers_alone_take_the_size_of_the_images(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, name, SIZELESS[name])
    assert read_camera(path, image_size=lambda: (640, 480)).camera == CAMERA
    with pytest.raises(InputError):
        read_camera(path, image_size=lambda: (256, 192))  # of another resolution


def test_a_field_of_view_takes_the_width_of_the_images(tmp_path: Path) -> None:
    """Blender's own transforms.json."""
    path = write(tmp_path, "transforms_train.json", json.dumps({"camera_angle_x": 2 * np.arctan(0.5), "frames": []}))
    found = read_camera(path, image_size=lambda: (640, 480)).camera
    assert (found.fx, found.fy, found.cx, found.cy) == pytest.approx((640, 640, 319.5, 239.5))


def test_opencvs_arrays_are_read_from_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "calib.npz", mtx=ROWS, dist=[BENT], rvecs=np.ones((2, 3, 1)), ret=0.3)
    found = read_camera(tmp_path / "calib.npz", image_size=lambda: (640, 480))
    assert found.camera == CAMERA and found.lens is not None and found.lens.coefficients == tuple(BENT)


BENDING = {
    "ost.txt": OST % "-0.3 0.1 0.001 -0.001 0.02",
    "orbbec.ini#depth": ORBBEC,
    "matlab.json": json.dumps(MATLAB | {"RadialDistortion": BENT[:2] + BENT[4:], "TangentialDistortion": BENT[2:4]}),
    "oak.json": json.dumps({"cameraData": [[2, SIZE | {"distortionCoeff": BENT, "intrinsicMatrix": ROWS}]]}),
    "flat.json#depth": json.dumps({"depth_fx": 600.0, "depth_fy": 601.0, "depth_cx": 320.5, "depth_cy": 240.25}
    | {"depth_width": 640, "depth_height": 480, "depth_distortion": BENT, "color_fx": 1.0}),
    "radial.json": json.dumps(
        SIZE | NAMED | {"radialDistortion": BENT[:2] + BENT[4:], "tangentialDistortion": BENT[2:4]}
    ),
    "photoneo.txt": "CameraMatrix: 600 0 320.5 0 601 240.25 0 0 1\nResolution: 640 480\n"
    "DistortionCoefficients: -0.3 0.1 0.001 -0.001 0.02 0 0 0\n",
    "exponents.yaml": f"K: {FLAT}\nwidth: 640\nheight: 480\nD: [-3e-1, 1e-1, 1e-3, -1e-3, 2e-2]\n",
}  # fmt: skip


@pytest.mark.parametrize("name", BENDING)
def test_distortion_goes_with_its_camera(tmp_path: Path, name: str) -> None:
    file, _, selector = name.partition("#")
    path = write(tmp_path, file, BENDING[name])
    found = read_camera(f"{path}#{selector}" if selector else path)
    assert found.lens is not None
    assert found.lens.coefficients[:5] == pytest.approx(BENT)


SEVERAL = {
    "dexycb.yml": json.dumps({"color": COLOR, "depth": SIZE | NAMED}),
    "rs.txt": (REALSENSE % ("Depth", "640x480")) + (REALSENSE % ("Color", "1920x1080")).replace("640", "1920")
    .replace("480", "1080").replace("320.5", "960").replace("240.25", "540"),
    "orbbec.ini": ORBBEC.partition("[DepthDistort]")[0],
    "flat.txt": "colorWidth = 1920\ncolorHeight = 1080\nfx_color = 1400\nfy_color = 1400\nmx_color = 960\n"
    "my_color = 540\n" + READ["scannet.txt"],
    "sizes as names.json": json.dumps({"1920x1080": {k: COLOR[k] for k in NAMED}, "640x480 depth": NAMED}),
    "list.json": json.dumps([{"name": "color"} | COLOR, {"name": "depth"} | SIZE | NAMED]),
    "cameras.txt": "1 PINHOLE 1920 1080 1400 1400 960 540\n2 PINHOLE 640 480 600 601 321 240.75\n",
}  # fmt: skip


@pytest.mark.parametrize("name", SEVERAL)
def test_of_several_cameras_the_one_that_is_named_or_that_has_the_images_size_is_taken(
    tmp_path: Path, name: str
) -> None:
    path = write(tmp_path, name, SEVERAL[name])
    with pytest.raises(InputError, match=r"holds several cameras \(.*1920.*say which one took the depth images"):
        read_camera(path)
    found = read_camera(path, image_size=lambda: (640, 480))
    assert found.camera == CAMERA and "is taken, of" in found.remarks[0]
    selected = f"{path}#{'2' if name == 'cameras.txt' else 'Depth'}"
    assert read_camera(selected, image_size=lambda: (640, 480)).camera == CAMERA
    with pytest.raises(InputError, match="none of its cameras"):
        read_camera(path, image_size=lambda: (100, 100))
    with pytest.raises(InputError, match="holds no camera 'thermal'"):
        read_camera(f"{path}#thermal")


STEREO = {"M1": ROWS, "D1": [[0.0] * 5], "M2": [[610.0, 0, 320], [0, 610.0, 240], [0, 0, 1]], "D2": [[0.0] * 5]}
REFUSED = {
    "a stereo pair": (json.dumps(SIZE | STEREO), "several cameras"),
    "cameras that differ": (json.dumps({"frames": [SIZE | NAMED, SIZE | NAMED | {"fx": 610.0}]}), "several cameras"),
    "another order": (json.dumps(SIZE | {"intrinsics": [600, 320, 601, 240]}), "mend their order"),
    "a camera and another of an image": (
        json.dumps(NERF | {"frames": [{"fl_x": 700.0, "fl_y": 700.0, "cx": 321, "cy": 240, "w": 640, "h": 480}]}),
        "several cameras",
    ),
    "azure kinect": (json.dumps({"CalibrationInformation": {"Cameras": []}}), "factory calibration"),
    "zed": ("[LEFT_CAM_HD]\nfx=700\nfy=700\ncx=640\ncy=360\n[RIGHT_CAM_HD]\nfx=701\n", "rectified camera"),
    "realsense settings": (json.dumps({"param-depthunits": "1000"}), "rs-enumerate-devices -c"),
    "a topic as a table": ("%time,field.header.seq,field.height\n1,2,480\n", "rostopic echo"),
    "halcon with distortion": (HALCON % "-2253.5", "HALCON's own"),
    "a field twice": ("fx: 600\nfy: 601\nfx: 610\ncx: 320\ncy: 240\nwidth: 640\nheight: 480\n", "stands twice"),
    "a field of JSON twice": ('{"fx": 600, "fx": 610, "fy": 600, "cx": 3, "cy": 2, "width": 6, "height": 4}', "twice"),
    "millimeters": (json.dumps(SIZE | {"focal_length": 4.5, "cx": 320, "cy": 240}), "make no sense"),
    "shares of the image": (json.dumps(SIZE | {"fx": 0.9, "fy": 1.2, "cx": 0.5, "cy": 0.5}), "make no sense"),
    "height first": (json.dumps(NAMED | {"image_size": [480, 640]}), "height may stand first"),
    "an unknown distortion": (json.dumps(SIZE | NAMED | {"lens_distortion_table": [0.1, 0.2]}), "bends the image"),
    "K4A's offset": (json.dumps(SIZE | NAMED | {"codx": 0.01}), "bends the image"),
    "kalibr equidistant": ("cam0:\n  camera_model: pinhole\n  intrinsics: [600, 601, 320.5, 240.25]\n"
    "  distortion_model: equi\n  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n", "fisheye"),
    "a pose": ("1 0 0 0.5\n0 1 0 0.1\n0 0 1 0.7\n0 0 0 1\n", "row by row|make no sense|no camera"),
    "a rotation": (json.dumps({"rotation": np.eye(3).tolist(), "translation": [0, 0, 1]}), "holds no camera"),
    "a broken archive": (b"PK\x03\x04abc", "not a"),
    "a picture": (b"\x89PNG\r\n\x1a\n\x00\x00", "not a"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_read_right_is_refused_in_one_sentence(tmp_path: Path, kind: str) -> None:
    text, says = REFUSED[kind]
    path = write(tmp_path, "bad.json" if kind == "a field of JSON twice" else "bad.txt", text)
    with pytest.raises(InputError, match=says) as error:
        read_camera(path, image_size=lambda: (640, 480))
    assert "bad" in str(error.value) and "\n" not in str(error.value)


def test_a_center_far_from_the_middle_is_said(tmp_path: Path) -> None:
    path = write(tmp_path, "crop.json", json.dumps(SIZE | NAMED | {"cx": 560.0}))
    (remark,) = read_camera(path).remarks
    assert "far from the middle" in remark


def test_the_command_takes_one_of_several_cameras(tmp_path: Path) -> None:
    path = write(tmp_path, "dexycb.yml", SEVERAL["dexycb.yml"])
    result = CliRunner().invoke(camera_command, [f"{path}#depth"])
    assert result.exit_code == 0 and "640 x 480" in result.stdout
