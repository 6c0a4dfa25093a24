"""Cameras of ROS and BOP, as their own tools write them, and what is none."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_files import read_camera

CALIBRATOR = """\
image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: [525.5, 0., 319.25, 0., 5.24e+02, 239.75, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [%s, 0., 0., 0., 0.]
projection_matrix:
  rows: 3
  cols: 4
  data: [500., 0., 320., 0., 0., 500., 240., 0., 0., 0., 1., 0.]
"""
TOPIC = """\
header:
  seq: 7
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.0, 0.0, 0.0, 0.0, 0.0]
K: [525.5, 0.0, 319.25, 0.0, 524.0, 239.75, 0.0, 0.0, 1.0]
P: [500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
---
"""
EXPECTED = Camera(640, 480, 525.5, 524.0, 319.25, 239.75)


def load(folder: Path, text: str, name: str = "camera.yaml") -> Camera:
    (folder / name).write_text(text)
    return Camera.load(folder / name)


@pytest.mark.parametrize(
    "text",
    [CALIBRATOR % "0.", TOPIC, TOPIC.replace("K:", "k:").replace("D:", "d:").replace("P:", "p:")],
    ids=["calibrator", "ROS 1 topic", "ROS 2 topic"],
)
def test_a_camera_info_is_its_camera_matrix_for_images_as_taken(tmp_path: Path, text: str) -> None:
    assert load(tmp_path, text) == EXPECTED
    (remark,) = read_camera(tmp_path / "camera.yaml").remarks
    assert "matrix K" in remark and "--rectified" in remark


def test_the_projection_matrix_is_what_rectified_images_follow(tmp_path: Path) -> None:
    assert load(tmp_path, CALIBRATOR % "-0.31") == EXPECTED
    found = read_camera(tmp_path / "camera.yaml", rectified=True)
    assert found.camera == Camera(640, 480, 500, 500, 320, 240)
    assert found.lens is None
    assert "projection matrix P" in found.remarks[0]


def test_where_both_matrices_are_one_nothing_is_said(tmp_path: Path) -> None:
    text = TOPIC.replace("500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0", "525.5, 0.0, 319.25, 0.0, 0.0, 524.0, 239.75")
    assert load(tmp_path, text) == EXPECTED
    assert read_camera(tmp_path / "camera.yaml").remarks == ()


def test_the_projection_matrix_stands_in_where_there_is_no_camera_matrix(tmp_path: Path) -> None:
    text = "\n".join(line for line in TOPIC.splitlines() if not line.startswith("K"))
    assert load(tmp_path, text, "info.yml") == Camera(640, 480, 500, 500, 320, 240)


def test_a_camera_info_may_be_json(tmp_path: Path) -> None:
    document = {"width": 640, "height": 480, "k": [525.5, 0, 319.25, 0, 524, 239.75, 0, 0, 1], "d": []}
    assert load(tmp_path, json.dumps(document), "info.json") == EXPECTED


BASE = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0}
K = [600.0, 0, 320.0, 0, 600.0, 240.0, 0, 0, 1]


@pytest.mark.parametrize(
    "more",
    [
        {"distortion_coefficients": [-0.3, 0.1, 0, 0, 0]},
        {"D": [[-0.3, 0.1, 0, 0, 0]]},
        {"dist": {"data": [-0.3, 0.1, 0, 0]}},
        {"k1": -0.3, "k2": 0.1},
        {"distortion": {"k1": -0.3, "k2": 0.1, "p1": 0.0}},
        {"model": 4, "coeffs": [-0.3, 0.1, 0, 0, 0]},
        {"camera_model": "OPENCV", "k1": -0.3, "k2": 0.1},
    ],
)
def test_distortion_is_a_lens_and_is_said_in_one_sentence(
    tmp_path: Path, more: dict[str, object], caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever takes the pinhole camera alone hears of it; whoever reads the file has the lens."""
    camera = load(tmp_path, json.dumps(BASE | more), "camera.json")
    assert camera == Camera(640, 480, 600, 600, 320, 240)
    (said,) = caplog.messages
    assert "camera.json" in said and "distortion" in said and "rectify" in said
    lens = read_camera(tmp_path / "camera.json").lens
    assert lens is not None and lens.coefficients[:4] == (-0.3, 0.1, 0, 0)


def test_skew_is_part_of_the_lens(tmp_path: Path) -> None:
    skewed = TOPIC.replace("K: [525.5, 0.0", "K: [525.5, 2.0")
    for text, name in ((json.dumps(BASE | {"skew": 2.0}), "a.json"), (skewed, "a.yaml")):
        (tmp_path / name).write_text(text)
        lens = read_camera(tmp_path / name).lens
        assert lens is not None and lens.skew == 2.0


OPENCV = """%YAML:1.0
---
calibration_time: "Sat 01 Feb 2025"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 320., 0., 600., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.0e-01, 1.0e-01, 0., 0., 0. ]
"""
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>640</image_width><image_height>480</image_height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>600. 0. 320. 0. 600. 240. 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>-3.0e-01 1.0e-01 0. 0. 0.</data></Distortion_Coefficients>
</opencv_storage>
"""
ZIVID = """__version__: {serializer: 1}
image_width: 640
image_height: 480
CameraIntrinsics:
  CameraMatrix: {CX: 320.0, CY: 240.0, FX: 600.0, FY: 600.0}
  Distortion: {K1: -0.3, K2: 0.1, K3: 0, P1: 0, P2: 0}
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [600.0, 600.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [-0.3, 0.1, 0.0, 0.0]
  resolution: [640, 480]
"""
PINHOLE = {
    "RealSense.json": json.dumps(
        {"width": 640, "height": 480, "ppx": 320.0, "ppy": 240.0, "fx": 600.0, "fy": 600.0, "model": "Brown Conrady"}
        | {"coeffs": [0.0] * 5}
    ),
    "nested.json": json.dumps({"serial": "1", "depth_intrinsics": BASE}),
    "Open3D.json": json.dumps({"width": 640, "height": 480, "intrinsic_matrix": [600, 0, 0, 0, 600, 0, 320, 240, 1]}),
    "Open3D_view.json": json.dumps(
        {"class_name": "PinholeCameraParameters", "extrinsic": [1] * 16}
        | {"intrinsic": {"width": 640, "height": 480, "intrinsic_matrix": [600, 0, 0, 0, 600, 0, 320, 240, 1]}}
    ),
    "by_rows.json": json.dumps({"width": 640, "height": 480, "intrinsic_matrix": K}),
    "rows.json": json.dumps({"image_size": [640, 480], "K": [K[:3], K[3:6], K[6:]]}),
    "nerfstudio.json": json.dumps({"w": 640, "h": 480, "fl_x": 600, "fl_y": 600, "cx": 320.5, "cy": 240.5}),
    "colmap.txt": "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE 640 480 600 600 320.5 240.5\n",
    "camera_params.txt": "width\t640\nheight\t480\nfu\t600\nfv\t600\ncu\t320\ncv\t240\nrotation\t1\t0\t0\t0\n",
}
DISTORTED = {
    "calibration.yml": OPENCV,
    "calibration.yaml": OPENCV.replace("camera_matrix", "cameraMatrix").replace(
        "distortion_coefficients", "distCoeffs"
    ),
    "calibration.xml": OPENCV_XML,
    "calibration.json": json.dumps(
        {"image_width": 640, "image_height": 480}
        | {"camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": K}}
        | {"distortion_coefficients": {"type_id": "opencv-matrix", "rows": 1, "cols": 4, "data": [-0.3, 0.1, 0, 0]}}
    ),
    "zivid.yml": ZIVID,
    "camchain.yaml": KALIBR,
    "cameras.txt": "1 OPENCV 640 480 600 600 320.5 240.5 -0.3 0.1 0 0\n",
}


@pytest.mark.parametrize("name", PINHOLE | DISTORTED)
def test_what_cameras_and_their_tools_write_is_read(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text((PINHOLE | DISTORTED)[name])
    found = read_camera(tmp_path / name)
    assert found.camera == Camera(640, 480, 600, 600, 320, 240)
    assert (found.lens is None) == (name in PINHOLE)
    if found.lens is not None:
        assert found.lens.coefficients[:4] == (-0.3, 0.1, 0, 0)


def test_a_window_of_the_sensor_is_applied(tmp_path: Path) -> None:
    """By the definition of camera_info: the roi in pixels of the whole sensor, then the binning; drivers vary."""
    info = {"K": [405.0, 0, 631.0, 0, 405.0, 376.0, 0, 0, 1], "binning_x": 0, "binning_y": 0}
    roi = {"x_offset": 320, "y_offset": 200, "width": 640, "height": 400, "do_rectify": False}
    whole, window = {"width": 1280, "height": 800}, {"width": 640, "height": 400}
    cut = Camera(640, 400, 405, 405, 311, 176)
    for sizes in (whole, window):
        assert load(tmp_path, json.dumps(info | sizes | {"roi": roi})) == cut
    everything = {"roi": dict.fromkeys(roi, 0)}
    assert load(tmp_path, json.dumps(info | whole | everything)) == Camera(1280, 800, 405, 405, 631, 376)
    binned = info | whole | {"roi": roi, "binning_x": 2, "binning_y": 2}
    assert load(tmp_path, json.dumps(binned)) == cut.resized(320, 200)
    assert len(read_camera(tmp_path / "camera.yaml").remarks) == 2


def test_a_scenes_cameras_of_bop_are_one_where_all_images_share_it(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "depth" / "000000.png"), np.zeros((480, 640), np.uint16))
    entries = {str(i): {"cam_K": K, "depth_scale": 0.1} for i in range(3)}
    (tmp_path / "scene_camera.json").write_text(json.dumps(entries))
    found = read_camera(tmp_path / "scene_camera.json")
    assert found.camera == Camera(640, 480, 600, 600, 320, 240)
    assert found.depth_unit == pytest.approx(1e-4)
    entries["2"]["cam_K"] = [*K[:2], 321.0, *K[3:]]
    (tmp_path / "scene_camera.json").write_text(json.dumps(entries))
    with pytest.raises(InputError, match=r"different cameras.*posenet predict"):
        read_camera(tmp_path / "scene_camera.json")


CONTRADICTIONS = {
    "two focal lengths": BASE | {"K": [601.0, *K[1:]]},
    "two matrices": {"width": 640, "height": 480, "K": K, "camera_matrix": [601.0, *K[1:]]},
    "two widths": BASE | {"image_width": 641},
    "a width and a size": BASE | {"resolution": [641, 480]},
    "one focal length and two": BASE | {"focal_length": 601.0},
    "a principal point and another": BASE | {"principal_point": [300.0, 200.0]},
    "a matrix and one number of it": {"width": 640, "height": 480, "K": K, "fx": 601.0},
    "two skews": {"width": 640, "height": 480, "K": [K[0], 2.0, *K[2:]], "skew": 3.0},
    "a list of coefficients and one of them": BASE | {"D": [0.1, 0, 0, 0], "k1": 0.2},
    "a size within and another without": {"width": 1280, "camera": BASE},
    "two distortions": BASE | {"D": [0.1, 0, 0, 0], "dist_coeffs": [0.2, 0, 0, 0]},
    "the window is not in the image": BASE | {"roi": {"x_offset": 600, "y_offset": 0, "width": 100, "height": 480}},
    "a matrix of the window already": BASE
    | {"cx": 311.0, "height": 400, "roi": {"x_offset": 320, "y_offset": 200, "width": 640, "height": 400}},
    "a number as text": BASE | {"fx": "600.0"},
    "a size as text": BASE | {"width": "640"},
    "coefficients as text": BASE | {"D": ["0.1", 0, 0, 0]},
    "six coefficients": BASE | {"D": [0.1, 0, 0, 0, 0, 0]},
    "a tilted sensor": BASE | {"D": [0.1] * 14},
    "an unknown lens": BASE | {"distortion_model": "division", "D": [0.1, 0, 0, 0]},
    "two cameras": {"color": BASE, "depth": BASE | {"fx": 601.0}},
    "a fisheye of OpenCV": BASE | {"fisheye_model": 1},
    "a fisheye of nerfstudio": BASE | {"camera_model": "OPENCV_FISHEYE"},
    "a fisheye of RealSense": BASE | {"model": 3},
    "binned away": BASE | {"binning_x": 900, "binning_y": 1},
}


AGREEING = {
    "an integer and a number": BASE | {"image_width": 640.0},
    "one focal length twice": BASE | {"focal_length": [600.0, 600.0 * (1 + 1e-9)]},
    "a matrix and all its numbers": BASE | {"K": K},
    "within and without": {"width": 640, "camera": BASE},
    "coefficients twice": BASE | {"D": [0.1, 0, 0, 0], "k1": 0.1},
}


@pytest.mark.parametrize("document", AGREEING.values(), ids=AGREEING)
def test_what_is_said_twice_and_agrees_is_read(tmp_path: Path, document: dict[str, object]) -> None:
    (tmp_path / "camera.json").write_text(json.dumps(document))
    found = read_camera(tmp_path / "camera.json")
    (tmp_path / "base.json").write_text(json.dumps(BASE))
    assert found.camera == read_camera(tmp_path / "base.json").camera


@pytest.mark.parametrize("document", CONTRADICTIONS.values(), ids=CONTRADICTIONS)
def test_what_contradicts_itself_or_is_not_modeled_is_refused_in_one_sentence(
    tmp_path: Path, document: dict[str, object]
) -> None:
    (tmp_path / "bad.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"bad\.json") as error:
        read_camera(tmp_path / "bad.json")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("model", ["equidistant", "fisheye", "thin_prism_fisheye", "Kannala_Brandt4"])
def test_a_fisheye_is_refused_even_without_coefficients(tmp_path: Path, model: str) -> None:
    with pytest.raises(InputError, match=rf"camera\.yaml.*{model}.*rectify"):
        load(tmp_path, TOPIC.replace("plumb_bob", model))


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "Inverse Brown Conrady", "None", ""])
def test_other_lenses_without_coefficients_are_pinholes(tmp_path: Path, model: str) -> None:
    assert load(tmp_path, TOPIC.replace("plumb_bob", model)) == EXPECTED
    assert read_camera(tmp_path / "camera.yaml").lens is None


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    for text, name, says in (
        (CALIBRATOR.replace("image_width: 640\n", "") % 0, "a.yaml", "image_width"),
        ('{"fx": 9, "fy": 9, "cx": 4, "width": 8, "height": 8}', "a.json", "'cy'"),
        ('{"0": {"cam_K": [9, 0, 4, 0, 9, 4, 0, 0, 1], "depth_scale": 1.0}}', "scene_camera.json", "BOP camera.json"),
    ):
        with pytest.raises(InputError, match=says):
            load(tmp_path, text, name)


def test_bops_camera_has_our_fields(tmp_path: Path) -> None:
    document = {"cx": 325.2611, "cy": 242.04899, "depth_scale": 1.0, "fx": 572.4114, "fy": 573.57043}
    document |= {"height": 480, "width": 640}
    assert load(tmp_path, json.dumps(document), "camera.json") == Camera(
        640, 480, 572.4114, 573.57043, 325.2611, 242.04899
    )


def test_our_own_camera_may_be_yaml(tmp_path: Path) -> None:
    assert load(tmp_path, "\n".join(f"{key}: {value}" for key, value in EXPECTED.to_json().items())) == EXPECTED


BAD = {
    "empty": "",
    "a list": "[1, 2]",
    "no matrix": "image_width: 640\nimage_height: 480\n",
    "no size": TOPIC.replace("width", "breadth"),
    "eight numbers": TOPIC.replace("K: [525.5, ", "K: ["),
    "never calibrated": re.sub(r"K: .*", "K: [0, 0, 0, 0, 0, 0, 0, 0, 0]", TOPIC),
    "half transposed": re.sub(r"K: .*", "K: [525.5, 0, 319.25, 0, 524, 0, 0, 239.75, 1]", TOPIC),
    "words": TOPIC.replace("524.0", "wide"),
    "not a number": TOPIC.replace("524.0", ".nan"),
    "negative": TOPIC.replace("524.0", "-524.0"),
    "half a pixel": TOPIC.replace("width: 640", "width: 640.5"),
    "distortion in words": TOPIC.replace("D: [0.0", "D: [none"),
    "not YAML": "image_width: [640\n  : }",
    "binary": "\x00\x01",
    "a date of no calendar": "image_width: 2020-99-99",
    "a tag": "!!python/object/apply:os.system ['true']",
    "an OpenCV file": "%YAML:1.0\n---\nimage_width: 640\n",
    "too deep": "[" * 5000,
}  # fmt: skip


@pytest.mark.parametrize("text", BAD.values(), ids=BAD)
def test_what_is_no_camera_is_refused_in_one_sentence_that_names_the_file(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"bad\.yaml") as error:
        load(tmp_path, text, "bad.yaml")
    assert "\n" not in str(error.value)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"bad\.yaml: too large"):
        load(tmp_path, "#" * (2 << 20), "bad.yaml")
