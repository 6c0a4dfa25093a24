"""Cameras of ROS and BOP, as their own tools write them, and what is none."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

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
def test_a_camera_info_is_its_camera_matrix(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert load(tmp_path, text) == EXPECTED
    assert capsys.readouterr().err == ""


def test_the_projection_matrix_stands_in_where_there_is_no_camera_matrix(tmp_path: Path) -> None:
    text = "\n".join(line for line in TOPIC.splitlines() if not line.startswith("K"))
    assert load(tmp_path, text, "info.yml") == Camera(640, 480, 500, 500, 320, 240)


def test_a_camera_info_may_be_json(tmp_path: Path) -> None:
    document = {"width": 640, "height": 480, "k": [525.5, 0, 319.25, 0, 524, 239.75, 0, 0, 1], "d": []}
    assert load(tmp_path, json.dumps(document), "info.json") == EXPECTED


def test_lens_distortion_is_said_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert load(tmp_path, CALIBRATOR % "-0.31") == EXPECTED
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert "camera.yaml" in said.err and "distortion" in said.err and "rectify" in said.err


@pytest.mark.parametrize("model", ["equidistant", "fisheye", "thin_prism_fisheye", "Kannala_Brandt4"])
def test_a_fisheye_is_refused_even_without_coefficients(tmp_path: Path, model: str) -> None:
    with pytest.raises(InputError, match=rf"camera\.yaml.*{model}.*rectify"):
        load(tmp_path, TOPIC.replace("plumb_bob", model))


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "Inverse Brown Conrady", "None", ""])
def test_other_lenses_without_coefficients_are_pinholes(
    tmp_path: Path, model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert load(tmp_path, TOPIC.replace("plumb_bob", model)) == EXPECTED
    assert capsys.readouterr().err == ""


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
    "skewed": TOPIC.replace("K: [525.5, 0.0", "K: [525.5, 2.0"),
    "transposed": re.sub(r"K: .*", "K: [525.5, 0, 0, 0, 524, 0, 319.25, 239.75, 1]", TOPIC),
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
