"""Projection and unprojection undo each other; pixels are counted from their centers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

CAMERA = Camera(64, 48, 70.0, 65.0, 30.5, 25.0)


def test_projecting_undoes_unprojecting() -> None:
    rng = np.random.default_rng(0)
    pixels, depth = rng.uniform(-50, 100, (3, 20, 2)), rng.uniform(0.1, 5, (3, 20))
    points = CAMERA.unproject(pixels, depth)
    assert points[..., 2] == pytest.approx(depth)
    assert CAMERA.project(points) == pytest.approx(pixels)


def test_projection_is_the_matrix_of_intrinsics() -> None:
    points = np.random.default_rng(0).uniform(0.5, 2, (10, 3))
    homogeneous = points @ CAMERA.matrix.T
    assert CAMERA.project(points) == pytest.approx(homogeneous[:, :2] / homogeneous[:, 2:])


def test_the_principal_ray_meets_the_center_of_its_pixel() -> None:
    camera = Camera(5, 5, 10, 10, 2, 2)
    assert camera.point_map(np.full((5, 5), 0.7))[2, 2] == pytest.approx([0, 0, 0.7])


def test_the_point_map_is_the_unprojection_of_each_pixel() -> None:
    depth = np.random.default_rng(0).uniform(0.2, 1, (CAMERA.height, CAMERA.width))
    depth[3, 4] = 0
    points = CAMERA.point_map(depth)
    for v, u in [(0, 0), (47, 63), (10, 20)]:
        assert points[v, u] == pytest.approx(CAMERA.unproject([u, v], depth[v, u]))
    assert points[3, 4] == pytest.approx([0, 0, 0])


@pytest.mark.parametrize(("width", "height"), [(128, 96), (32, 24), (100, 30)])
def test_resizing_keeps_the_view(width: int, height: int) -> None:
    """A ray meets the image at the same share of its width and height, from the outer edges of the pixels."""
    resized = CAMERA.resized(width, height)
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 3], (20, 3))
    share = (CAMERA.project(points) + 0.5) / [CAMERA.width, CAMERA.height]
    assert (resized.project(points) + 0.5) / [width, height] == pytest.approx(share)
    assert resized.resized(CAMERA.width, CAMERA.height).to_json() == pytest.approx(CAMERA.to_json())


def test_json_keeps_the_camera(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    assert Camera.load(tmp_path / "camera.json") == CAMERA


GOOD = CAMERA.to_json()
BAD_DOCUMENTS = [
    "[]", "3", "{", "", "\x00", "[" * 100_000, json.dumps({k: v for k, v in GOOD.items() if k != "cy"}),
    *(json.dumps(GOOD | {field: value}) for field, value in [
        ("fx", "wide"), ("fx", None), ("fy", 0), ("cx", float("nan")), ("height", -1),
        ("width", 64.5), ("width", True), ("width", float("inf")), ("width", 10**9),
    ]),
]  # fmt: skip


@pytest.mark.parametrize("text", BAD_DOCUMENTS, ids=range(len(BAD_DOCUMENTS)))
def test_what_is_no_camera_is_refused_in_one_sentence_that_names_the_file(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InputError, match=r"bad\.json") as error:
        Camera.load(tmp_path / "bad.json")
    assert "\n" not in str(error.value)
