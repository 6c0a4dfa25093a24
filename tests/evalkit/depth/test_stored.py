"""Depth files as they come: read, refused in one sentence, or read with a remark on what is doubtful."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.depth.images import read_depth
from evalkit.errors import InputError

METERS = np.linspace(0.5, 0.7, 48 * 64).reshape(48, 64)
METERS[:4, :9] = 0.0
MILLIMETERS = np.round(METERS * 1e3).astype(np.uint16)
Write = Callable[[Path], object]


def pgm(path: Path) -> None:
    path.write_bytes(b"P5\n64 48\n65535\n" + MILLIMETERS.astype(">u2").tobytes())


READ: dict[str, Write] = {
    "a.pgm": pgm,
    "big endian.npy": lambda path: np.save(path, MILLIMETERS.astype(">u2")),
    "one.npz": lambda path: np.savez(path, anything=MILLIMETERS),
    "several.npz": lambda path: np.savez(path, depth=MILLIMETERS, mask=MILLIMETERS > 0, K=np.eye(3)),
    "negative.npy": lambda path: np.save(path, np.where(MILLIMETERS > 0, MILLIMETERS.astype(np.int32), -1)),
}
REFUSED: dict[str, tuple[Write, str]] = {
    "pages.tiff": (lambda path: cv2.imwritemulti(str(path), [MILLIMETERS, MILLIMETERS]), "holds 2 images"),
    "which.npz": (lambda path: np.savez(path, a=MILLIMETERS, b=MILLIMETERS), "which of its arrays"),
    "objects.npz": (lambda path: np.savez(path, depth=np.array([{}], object)), "not a readable NPZ"),
    "broken.npz": (lambda path: path.write_bytes(b"PK\x03\x04"), "not a readable NPZ"),
    "left_disparity.png": (lambda path: cv2.imwrite(str(path), MILLIMETERS), "disparities"),
    "a.raw": (lambda path: path.write_bytes(MILLIMETERS.tobytes()), "neither size nor type"),
    "opengl.npy": (lambda path: np.save(path, -METERS), "all negative"),
    "colors.png": (lambda path: cv2.imwrite(str(path), np.dstack([MILLIMETERS] * 3)), "one channel"),
}


@pytest.mark.parametrize("name", READ)
def test_what_sensors_and_programs_store_is_read(tmp_path: Path, name: str) -> None:
    READ[name](tmp_path / name)
    np.testing.assert_allclose(read_depth(tmp_path / name, 0.001), METERS, atol=6e-4)


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_depth_image_is_refused_in_one_sentence(tmp_path: Path, name: str) -> None:
    write, says = REFUSED[name]
    write(tmp_path / name)
    with pytest.raises(InputError, match=says) as error:
        read_depth(tmp_path / name, 0.001)
    assert name in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("code", [5000, 9999, 10000])
def test_a_value_far_beyond_all_others_is_said_and_kept(
    tmp_path: Path, code: int, caplog: pytest.LogCaptureFixture
) -> None:
    """It may be a sensor's code, and as well the flat ground under one part."""
    cv2.imwrite(str(tmp_path / "a.png"), np.where(MILLIMETERS > 0, MILLIMETERS, code).astype(np.uint16))
    with caplog.at_level(logging.INFO):
        depth = read_depth(tmp_path / "a.png", 0.001)
    assert depth.max() == pytest.approx(code / 1000)
    assert any(f"--no-return {code}" in message for message in caplog.messages)
    assert read_depth(tmp_path / "a.png", 0.001, no_return=code).max() < 1


def test_an_ordinary_image_has_no_remark(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), MILLIMETERS)
    with caplog.at_level(logging.INFO):
        read_depth(tmp_path / "a.png", 0.001)
    assert not caplog.messages


def test_an_image_without_any_return_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros_like(MILLIMETERS))
    assert not read_depth(tmp_path / "a.png", 0.001).any()
    assert "no return at all" in caplog.text
