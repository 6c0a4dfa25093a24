"""The IPA adapter: its mirrored camera frame, columns of the rotation, the window into a larger image."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit import InputError, average_precision
from evalkit.adapters import ipa
from evalkit.commands.cli import main
from evalkit.datasets.documents import read_ground_truth, read_predictions
from evalkit.geometry import poses

PARAMETERS = {
    "perspectiveAngle": 30.0, "resolution_big": 600, "resolutionX": 400, "resolutionY": 300,
    "pixelOffset_X_KoSyTopLeft": 90, "pixelOffset_Y_KoSyTopLeft": 140, "clip_start": 0.8, "clip_end": 1.9,
    "location": [0, 0, 2], "rotation": [1, 0, 0, 0],
}  # fmt: skip
AXES = [f"rot_{axis}_axis_{row}" for axis in "xyz" for row in (1, 2, 3)]
HEADER = ["id", "class", "x", "y", "z", *AXES, "visibility_score_o", "visibility_score_p"]
CORNERS = np.array([[0, 0, 0], [0.06, 0, 0], [0, 0.04, 0], [0, 0, 0.03]])


def write_table(path, rows):
    """Rows of (rotation, translation, last column); the bin comes first, as in the dataset."""
    lines = [",".join(HEADER), "0,bin,0,0,1.5,1,0,0,0,1,0,0,0,1,1,1"]
    for number, (rotation, translation, last) in enumerate(rows, 1):
        numbers = [*translation, *np.asarray(rotation).T.ravel(), 0.123, last]
        lines.append(f"{number},gear," + ",".join(f"{x:.9f}" for x in numbers))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def random_rows(count, seed=0):
    rng = np.random.default_rng(seed)
    places = np.stack([rng.uniform(-0.1, 0.1, count), rng.uniform(-0.1, 0.1, count), rng.uniform(1, 1.6, count)], -1)
    return list(zip(poses.random_rotations(rng, count), places, rng.uniform(0, 1, count), strict=True))


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "gear").mkdir()
    (tmp_path / "gear" / "parameter.json").write_text(json.dumps(PARAMETERS))
    for cycle, drop in ((0, 2), (3, 5)):
        write_table(tmp_path / "gear" / "gt" / f"cycle_{cycle:04d}" / f"{drop:03d}.csv", random_rows(drop, drop))
    return tmp_path / "gear"


@pytest.fixture
def mesh(tmp_path):
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "gear.obj").write_text("\n".join(lines))
    return {"mesh": tmp_path / "gear.obj", "units": "m", "symmetry": "none"}


def test_points_project_where_the_sensors_own_geometry_puts_them(folder, mesh):
    """Its large image is turned by half a turn, pixel centers lie at halves, x points left and y up."""
    truth = ipa.read_ground_truth(folder, **mesh)
    for image, drop in zip(truth.images, (2, 5), strict=True):
        for (rotation, translation, _), cam_from_obj in zip(random_rows(drop, drop), image.cam_from_obj, strict=True):
            x, y, z = (CORNERS @ rotation.T + translation).T
            meters_per_pixel = 2 * np.tan(np.radians(15)) * z / 600
            turned_u, turned_v = x / meters_per_pixel + 300 - 0.5, y / meters_per_pixel + 300 - 0.5
            expected = np.stack([599 - turned_u - 90, 599 - turned_v - 140], -1)
            np.testing.assert_allclose(image.camera.project(poses.apply(cam_from_obj, CORNERS)), expected, atol=1e-4)
    assert (truth.images[0].camera.width, truth.images[0].camera.height) == (400, 300)


def test_the_bin_is_no_instance_and_visibility_is_the_last_column(folder, mesh):
    truth = ipa.read_ground_truth(folder, **mesh)
    assert [image.id for image in truth.images] == ["000000-000002", "000003-000005"]
    for image, drop in zip(truth.images, (2, 5), strict=True):
        np.testing.assert_allclose(image.visibility, [row[2] for row in random_rows(drop, drop)], atol=1e-8)


def test_one_cycle_finds_the_parameters_above(folder, mesh):
    part = ipa.read_ground_truth(folder / "gt" / "cycle_0003", **mesh)
    assert [image.id for image in part.images] == ["000003-000005"]
    (folder / "parameter.json").unlink()
    with pytest.raises(InputError, match=r"parameter\.json.*--camera"):
        ipa.read_ground_truth(folder, **mesh)
    camera = folder / "camera.json"
    camera.write_text(json.dumps({"width": 9, "height": 8, "fx": 7, "fy": 7, "cx": 4, "cy": 4}))
    assert ipa.read_ground_truth(folder, camera=camera, **mesh).images[0].camera.width == 9


def test_an_empty_bin_has_no_instances(folder, mesh):
    write_table(folder / "gt" / "cycle_0000" / "000.csv", [])
    truth = ipa.read_ground_truth(folder, **mesh)
    assert truth.images[0].id == "000000-000000"
    assert truth.images[0].cam_from_obj.shape == (0, 4, 4)


def test_real_scenes_are_known_by_their_path(folder, mesh):
    write_table(folder / "gt" / "real" / "scene 7.csv", random_rows(1))
    assert "real-scene 7" in [image.id for image in ipa.read_ground_truth(folder, **mesh).images]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda text: text.replace("id,class", "number,class"), "first line"),
        (lambda text: "id,class,x,y,z\n", "first line"),
        (lambda text: "", "first line"),
        (lambda text: text.replace("2,gear,", "2,gear,wide,", 1), "line 4.*columns"),
        (lambda text: text.replace("2,gear,", "two,gear,", 1), "line 4"),
        (lambda text: text.replace("\n2,gear,", "\n2,gear", 1), "line 4.*16 columns"),
    ],
)
def test_a_table_that_cannot_be_read_is_refused_by_line(folder, mesh, change, word):
    path = folder / "gt" / "cycle_0000" / "002.csv"
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=rf"002\.csv.*{word}"):
        ipa.read_ground_truth(folder, **mesh)


@pytest.mark.parametrize(
    ("row", "word"),
    [
        ((2 * np.eye(3), [0, 0, 1.0], 0.5), "rotation"),
        ((np.diag([1.0, 1.0, -1.0]), [0, 0, 1.0], 0.5), "rotation"),
        ((np.eye(3), [0, 0, 1300.0], 0.5), "unit"),
        ((np.eye(3), [0, 0, 1.0], 1.5), "visibility"),
        ((np.eye(3), [0, 0, float("nan")], 0.5), "finite"),
    ],
)
def test_a_row_that_makes_no_sense_is_refused(folder, mesh, row, word):
    write_table(folder / "gt" / "cycle_0000" / "001.csv", [row])
    with pytest.raises(InputError, match=rf"001\.csv.*{word}"):
        ipa.read_ground_truth(folder, **mesh)


@pytest.mark.parametrize(
    "change",
    [
        {"perspectiveAngle": 200}, {"perspectiveAngle": "wide"}, {"resolution_big": None}, {"resolutionX": 0},
        {"pixelOffset_Y_KoSyTopLeft": float("inf")},
    ],
)  # fmt: skip
def test_parameters_that_make_no_sense_are_refused(folder, mesh, change):
    (folder / "parameter.json").write_text(json.dumps(PARAMETERS | change))
    with pytest.raises(InputError, match=r"parameter\.json"):
        ipa.read_ground_truth(folder, **mesh)


def test_depth_images_run_from_one_clipping_plane_to_the_other(folder):
    place = folder / "p_depth" / "cycle_0003"
    place.mkdir(parents=True)
    raw = np.zeros((300, 400), np.uint16)
    raw[0, 1:4] = 1, 32768, 65535
    cv2.imwrite(str(place / "005_depth_uint16.png"), raw)
    (image,) = ipa.depth_images(folder)
    assert image.id == "000003-000005"
    np.testing.assert_allclose(image.read()[0, :4], [0, 0.8 + 1.1 / 65535, 0.8 + 1.1 * 32768 / 65535, 0])
    (folder / "parameter.json").write_text(json.dumps(PARAMETERS | {"clip_end": 0.8}))
    with pytest.raises(InputError, match=r"parameter\.json.*clip_start"):
        list(ipa.depth_images(folder))


def test_what_is_missing_is_asked_for(folder, tmp_path):
    with pytest.raises(InputError, match="--mesh and --units"):
        ipa.read_ground_truth(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty.*cycle_0000"):
        ipa.read_ground_truth(tmp_path / "empty")


def test_the_commands_take_tables_to_a_score(folder, mesh, tmp_path):
    def evalkit(*arguments):
        done = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
        assert done.exit_code == 0, done.output

    mesh_options = ["--mesh", mesh["mesh"], "--units", "m", "--symmetry", "none"]
    evalkit("gt", folder, "--from", "ipa", *mesh_options, "-o", tmp_path / "gt.json")
    evalkit("preds", folder, "--from", "ipa", "-o", tmp_path / "preds.json")
    truth, predictions = read_ground_truth(tmp_path / "gt.json"), read_predictions(tmp_path / "preds.json")
    result = average_precision(predictions, truth, min_visibility=0.0)
    assert (result.ap, result.counts["true"]) == (1.0, 7)
