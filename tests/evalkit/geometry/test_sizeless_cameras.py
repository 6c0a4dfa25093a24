"""Files that hold a camera matrix and no image size: the images say it, if the matrix can be theirs."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.depth.sources import open_source
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_files import read_camera

MATRIX = np.array([[61.5, 0.0, 31.25], [0.0, 60.5, 23.5], [0.0, 0.0, 1.0]])
CAMERA = Camera(64, 48, 61.5, 60.5, 31.25, 23.5)
ZIVID = {"CameraMatrix": {"CX": 31.25, "CY": 23.5, "FX": 61.5, "FY": 60.5}, "Distortion": {"K1": 0, "K2": 0}}
ORB_SLAM = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 61.5
Camera.fy: 60.5
Camera.cx: 31.25
Camera.cy: 23.5
Camera.k1: 0.0
DepthMapFactor: 5000.0
"""


def write(folder: Path, kind: str) -> Path:
    """A camera file of that kind, named as it usually is."""
    name = {"savetxt": "cam_K.txt", "commas": "K.txt", "one row": "K.txt", "npy": "K.npy", "orb": "TUM1.yaml"}
    path = folder / name.get(kind, "K.json")
    if kind == "npy":
        np.save(path, MATRIX)
    elif kind in ("savetxt", "commas"):
        np.savetxt(path, MATRIX, delimiter=", " if kind == "commas" else " ")
    else:
        text = {
            "one row": " ".join(str(value) for value in MATRIX.flatten()),
            "list": json.dumps(MATRIX.tolist()),
            "named": json.dumps({"K": MATRIX.tolist()}),
            "zivid": json.dumps(ZIVID),
            "orb": ORB_SLAM,
        }[kind]
        path.write_text(text)
    return path


KINDS = ("savetxt", "commas", "one row", "npy", "list", "named", "zivid", "orb")


@pytest.mark.parametrize("kind", KINDS)
def test_the_images_say_what_the_file_does_not(tmp_path: Path, kind: str) -> None:
    found = read_camera(write(tmp_path, kind), image_size=lambda: (64, 48))
    assert found.camera == CAMERA and found.lens is None
    assert "holds no image size; that of the images, 64 x 48, is taken" in found.remarks[0]


@pytest.mark.parametrize("kind", KINDS)
def test_without_images_the_size_is_missed(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InputError, match="no image size"):
        read_camera(write(tmp_path, kind))


def test_a_matrix_for_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="far from the middle of images of 128 x 96"):
        read_camera(write(tmp_path, "savetxt"), image_size=lambda: (128, 96))


def test_a_file_that_says_its_size_keeps_it(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA.to_json()))
    found = read_camera(path, image_size=lambda: pytest.fail("the images were looked at"))
    assert found.camera == CAMERA and not found.remarks


def test_a_window_of_a_sensor_of_unknown_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"K": MATRIX.flatten().tolist(), "binning_x": 2}))
    with pytest.raises(InputError, match="no image size"):
        read_camera(path, image_size=lambda: (64, 48))


def test_numbers_that_are_no_camera_matrix_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "pose.txt"
    np.savetxt(path, np.eye(4))
    with pytest.raises(InputError, match=r"pose\.txt"):
        read_camera(path, image_size=lambda: (64, 48))
    np.savetxt(path, MATRIX[::-1])
    with pytest.raises(InputError, match="row by row"):
        read_camera(path, image_size=lambda: (64, 48))


def test_a_matrix_by_columns_is_read_so_and_that_is_said(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "K.txt", MATRIX.T)
    found = read_camera(tmp_path / "K.txt", image_size=lambda: (64, 48))
    assert found.camera == CAMERA and any("by columns" in remark for remark in found.remarks)


def test_a_fisheye_of_orb_slam_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "TUM-VI.yaml"
    path.write_text(ORB_SLAM.replace("PinHole", "KannalaBrandt8"))
    with pytest.raises(InputError, match="fisheye"):
        read_camera(path, image_size=lambda: (64, 48))


def test_orb_slams_depth_factor_is_the_depth_unit(tmp_path: Path) -> None:
    assert read_camera(write(tmp_path, "orb"), image_size=lambda: (64, 48)).depth_unit == 1 / 5000


@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_a_folder_of_images_with_a_bare_matrix_is_read(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "frames").mkdir()
    depth = np.full((48, 64), 700, np.uint16)
    path = tmp_path / "frames" / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, depth)
    else:
        cv2.imwrite(str(path), depth)
    source = open_source(tmp_path / "frames", write(tmp_path, "savetxt"), 0.001)
    assert source.camera == CAMERA
    np.testing.assert_allclose(source.read(0), 0.7)
