"""Depth files of every kind say the same depth: codes for no return, units, rays, turns, lenses, point clouds."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.depth.clean import clean_depth
from evalkit.depth.images import Reading, read_depth
from evalkit.depth.no_return import without_code
from evalkit.depth.pcd import decompress_lzf
from evalkit.depth.sources import open_source
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.lens import Lens

CAMERA = Camera(40, 30, 50.0, 51.0, 19.0, 15.5)


def surface() -> np.ndarray:
    """A slanted plane with a hole, in meters."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    depth = (0.6 + 0.004 * u + 0.002 * v).astype(np.float32)
    depth[5:9, 7:12] = 0.0
    return depth


def write_camera(folder: Path, **more: object) -> Path:
    path = folder / "their_camera.json"
    path.write_text(json.dumps(CAMERA.to_json() | more))
    return path


def steps(holes: int, unit: float = 1e-3) -> np.ndarray:
    raw = np.round(surface() / unit).astype(np.uint16)
    raw[raw == 0] = holes
    return raw


@pytest.mark.parametrize("code", [0, 65535])
@pytest.mark.parametrize("unit", [1e-3, 1e-4])
def test_a_saturated_value_is_no_return_and_that_is_said(
    tmp_path: Path, code: int, unit: float, caplog: pytest.LogCaptureFixture
) -> None:
    cv2.imwrite(str(tmp_path / "depth.png"), steps(code, unit))
    with caplog.at_level(logging.INFO):
        depth = read_depth(tmp_path / "depth.png", unit)
    np.testing.assert_allclose(depth, surface(), atol=unit)
    assert (depth[5:9, 7:12] == 0).all()
    assert any("65535" in message and "no return" in message for message in caplog.messages) == (code == 65535)


@pytest.mark.parametrize("unit", [1e-3, 1e-4, 2.5e-4, 1 / 5000])
def test_saturated_depths_that_are_meters_already_are_no_return_too(unit: float) -> None:
    meters = steps(65535, unit).astype(np.float32) * np.float32(unit)
    clean = clean_depth(meters, CAMERA, "the image")
    assert clean.max() < 1.0
    assert (clean[5:9, 7:12] == 0).all()


@pytest.mark.parametrize("code", [2047, 4095, 32767])
def test_a_sensors_highest_value_is_a_code_where_it_is_frequent_and_far_from_the_rest(code: int) -> None:
    raw = steps(0)
    raw[:5] = code
    cleaned, found = without_code(raw)
    assert found == code and cleaned.max() < 1000
    wall = np.full_like(raw, code)  # a flat wall there is nothing but a wall
    wall[:, :20] = code - 300
    assert without_code(wall)[1] is None
    stray = steps(0)
    stray[0, 0] = code
    assert without_code(stray)[1] is None


def test_a_floor_under_one_part_is_no_code() -> None:
    raw = np.full((30, 40), 900, np.uint16)
    raw[10:20, 10:20] = 300
    assert without_code(raw)[1] is None
    assert without_code(raw.astype(np.float32) * np.float32(1e-3))[1] is None


def test_the_user_says_what_no_return_is(tmp_path: Path) -> None:
    raw = steps(9999)
    cv2.imwrite(str(tmp_path / "depth.png"), raw)
    assert read_depth(tmp_path / "depth.png", 1e-3).max() > 9
    np.testing.assert_allclose(read_depth(tmp_path / "depth.png", 1e-3, 9999), surface(), atol=1e-3)
    saturated = steps(65535)
    cv2.imwrite(str(tmp_path / "far.png"), saturated)
    assert read_depth(tmp_path / "far.png", 1e-3, no_return=0).max() > 65  # overridden: the wall is there


def test_millimeters_in_a_float_file_are_refused_until_the_unit_is_said(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", surface() * 1000)
    with pytest.raises(InputError, match=r"depth\.npy.*--depth-unit 0\.001"):
        read_depth(tmp_path / "depth.npy", None)
    np.testing.assert_allclose(read_depth(tmp_path / "depth.npy", 1e-3), surface(), atol=1e-6)


def test_depth_along_the_ray_becomes_depth_along_the_axis(tmp_path: Path) -> None:
    points = CAMERA.point_map(surface())
    np.save(tmp_path / "range.npy", np.linalg.norm(points, axis=-1))
    depth = Reading(along_ray=True).image(tmp_path / "range.npy", CAMERA)
    np.testing.assert_allclose(depth, surface(), atol=1e-6)


def test_an_image_on_its_side_is_refused_with_the_mend_and_turned_on_request(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.rot90(surface(), 1))  # turned counter-clockwise
    with pytest.raises(InputError, match=r"30 x 40.*40 x 30.*--rotate"):
        Reading().image(tmp_path / "depth.npy", CAMERA)
    np.testing.assert_array_equal(Reading(turned=90).image(tmp_path / "depth.npy", CAMERA), surface())
    np.save(tmp_path / "depth.npy", np.rot90(surface(), 2))
    np.testing.assert_array_equal(Reading(turned=180).image(tmp_path / "depth.npy", CAMERA), surface())


def test_a_lens_of_the_camera_file_rectifies_the_images_and_that_is_said(tmp_path: Path) -> None:
    coefficients = [-0.3, 0.1, 0.0, 0.0, 0.0]
    np.save(tmp_path / "depth.npy", surface())
    source = open_source(tmp_path / "depth.npy", write_camera(tmp_path, D=coefficients))
    expected = Lens(tuple(coefficients)).rectify(surface(), CAMERA)
    np.testing.assert_array_equal(source.read(0), expected)
    assert (expected != surface()).any()
    assert any("rectified" in remark for remark in source.remarks)
    plain = open_source(tmp_path / "depth.npy", tmp_path / "their_camera.json", rectified=True)
    np.testing.assert_array_equal(plain.read(0), surface())


def test_the_scale_of_depth_in_bops_camera_serves_whole_numbers_and_them_only(tmp_path: Path) -> None:
    camera = write_camera(tmp_path, depth_scale=0.1)
    cv2.imwrite(str(tmp_path / "a.png"), steps(0, 1e-4))
    np.save(tmp_path / "b.npy", surface())
    for name in ("a.png", "b.npy"):
        np.testing.assert_allclose(open_source(tmp_path / name, camera).read(0), surface(), atol=1e-4)
    cv2.imwrite(str(tmp_path / "a.png"), steps(0, 1e-3))
    np.testing.assert_allclose(open_source(tmp_path / "a.png", camera, 1e-3).read(0), surface(), atol=1e-3)


def test_an_exr_file_is_a_depth_image(tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR")
    depth = surface()
    depth[depth == 0] = 1e10  # as Blender writes its background
    for name, channels in (
        ("alone", {"Y": depth}),
        ("named", {"ViewLayer.Depth.Z": depth, "ViewLayer.Combined.R": depth * 0}),
        ("gray", {"R": depth, "G": depth, "B": depth}),
    ):
        openexr.File({"type": openexr.scanlineimage}, channels).write(str(tmp_path / f"{name}.exr"))
        np.testing.assert_allclose(read_depth(tmp_path / f"{name}.exr", None), surface(), atol=1e-6)
    openexr.File({"type": openexr.scanlineimage}, {"A": depth, "B": depth * 2}).write(str(tmp_path / "odd.exr"))
    with pytest.raises(InputError, match=r"odd\.exr.*channels"):
        read_depth(tmp_path / "odd.exr", None)
    (tmp_path / "torn.exr").write_bytes((tmp_path / "alone.exr").read_bytes()[:200])
    with pytest.raises(InputError, match=r"torn\.exr"):
        read_depth(tmp_path / "torn.exr", None)


def cloud(scale: float = 1.0) -> np.ndarray:
    """The surface's points (n, 3), NaN in the hole."""
    points = CAMERA.point_map(surface()) * scale
    points[surface() == 0] = np.nan
    return points.reshape(-1, 3).astype(np.float32)


def write_pcd(path: Path, data: str, points: np.ndarray, size: tuple[int, int] = (40, 30)) -> Path:
    """As PCL writes them, with a packed color and its padding between."""
    color = np.arange(len(points), dtype=np.float32)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {size[0]}\nHEIGHT {size[1]}\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA {data}\n"
    ).encode()
    table = np.column_stack([points, color]).astype("<f4")
    if data == "ascii":
        body = "\n".join(" ".join(f"{n:.9g}" for n in row) for row in table).encode()
    elif data == "binary":
        body = table.tobytes()
    else:
        plain = table.T.tobytes()
        packed = b"".join(bytes([len(plain[i : i + 32]) - 1]) + plain[i : i + 32] for i in range(0, len(plain), 32))
        body = np.array([len(packed), len(plain)], "<u4").tobytes() + packed
    path.write_bytes(header + body)
    return path


def write_ply(path: Path, text: bool, points: np.ndarray, lines: tuple[str, ...] = ()) -> Path:
    plyfile = pytest.importorskip("plyfile")
    vertices = np.array(list(map(tuple, points)), [("x", "f4"), ("y", "f4"), ("z", "f4")])
    element = plyfile.PlyElement.describe(vertices, "vertex")
    plyfile.PlyData([element], text=text, obj_info=list(lines)).write(str(path))
    return path


def test_an_organized_point_cloud_is_a_depth_image(tmp_path: Path) -> None:
    camera = write_camera(tmp_path)
    files = [write_pcd(tmp_path / f"{data}.pcd", data, cloud()) for data in ("ascii", "binary", "binary_compressed")]
    files += [write_ply(tmp_path / f"text-{text}.ply", text, cloud()) for text in (True, False)]
    zeros = np.nan_to_num(cloud())
    files.append(write_ply(tmp_path / "zeros.ply", False, zeros))
    for file in files:
        np.testing.assert_allclose(open_source(file, camera).read(0), surface(), atol=1e-6)
    millimeters = write_pcd(tmp_path / "mm.pcd", "binary", cloud(1000.0))
    with pytest.raises(InputError, match=r"mm\.pcd.*--depth-unit 0\.001"):
        open_source(millimeters, camera).read(0)
    np.testing.assert_allclose(open_source(millimeters, camera, 1e-3).read(0), surface(), atol=1e-6)


def test_a_cloud_without_a_camera_tells_its_own(tmp_path: Path) -> None:
    source = open_source(write_pcd(tmp_path / "a.pcd", "binary", cloud()))
    found = source.camera
    expected = [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]
    np.testing.assert_allclose([found.fx, found.fy, found.cx, found.cy], expected, rtol=1e-4)
    np.testing.assert_allclose(source.read(0), surface(), atol=1e-6)
    told = write_ply(tmp_path / "a.ply", False, cloud(), ("num_cols 40", "num_rows 30"))
    assert open_source(told).camera.width == 40


def test_a_cloud_that_lies_on_no_pixel_grid_is_refused_in_one_sentence(tmp_path: Path) -> None:
    camera, some = write_camera(tmp_path), cloud()[:700]
    shuffled = np.random.default_rng(0).permutation(cloud())
    turned = cloud()[:, [0, 2, 1]]
    refusals = [
        (write_pcd(tmp_path / "flat.pcd", "binary", some, (700, 1)), camera, "no pixel grid"),
        (write_ply(tmp_path / "few.ply", False, some), camera, "no pixel grid"),
        (write_ply(tmp_path / "few2.ply", False, some), None, "no pixel grid"),
        (write_pcd(tmp_path / "shuffled.pcd", "binary", shuffled), camera, "off the camera's grid"),
        (write_pcd(tmp_path / "shuffled2.pcd", "binary", shuffled), None, "no pinhole camera's grid"),
        (write_pcd(tmp_path / "turned.pcd", "binary", turned), camera, "off the camera's grid"),
    ]
    whole = write_pcd(tmp_path / "whole.pcd", "binary_compressed", cloud()).read_bytes()
    for name, data in (("torn.pcd", whole[:-100]), ("head.pcd", whole[:60]), ("no.pcd", b"\x00" * 50)):
        (tmp_path / name).write_bytes(data)
        refusals.append((tmp_path / name, camera, "PCD"))
    (tmp_path / "no.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    refusals.append((tmp_path / "no.ply", camera, "PLY"))
    for file, camera_file, says in refusals:
        with pytest.raises(InputError, match=says) as caught:
            open_source(file, camera_file).read(0)
        assert file.name in str(caught.value) and "\n" not in str(caught.value)


def test_copies_in_compressed_data_may_run_into_themselves() -> None:
    assert decompress_lzf(bytes([1, 97, 98, 0xE0, 1, 1]), 2 + 10) == b"ab" * 6
    with pytest.raises(ValueError, match="damaged"):
        decompress_lzf(bytes([0x20, 5]), 3)
