"""A table that was measured: the camera stands before it as the plane or the hand-eye pose says."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.commands.options import configured
from simgen.config_json import config_from_json
from simgen.config_sections import BinSize, ViewpointConfig
from simgen.presets import debug
from simgen.rendering.measured_table import read_table
from simgen.rendering.viewpoints import distance_range, draw_viewpoints, max_tilt, require_clear_table

CAMERA = Camera(320, 240, 300.0, 310.0, 150.0, 121.0)
SIZE = BinSize(0.3, 0.2, 0.1)
TILTED = poses.from_rotation_translation(
    np.diag([1.0, -1.0, -1.0]) @ poses.from_axis_angle([0.6, 0.8, 0.0], math.radians(25.0)), [0.02, -0.03, 0.7]
)


@pytest.mark.parametrize("scale", [1.0, -3.0])
def test_every_camera_sees_the_measured_plane_where_it_was_measured(scale: float) -> None:
    up, origin = TILTED[:3, 2], TILTED[:3, 3]
    numbers = ",".join(f"{number:.12g}" for number in scale * np.append(up, up @ origin))
    pose, turn = read_table(numbers, CAMERA)
    config = ViewpointConfig(cam_from_table=tuple(map(tuple, pose.tolist())), max_turn_degrees=turn, look_at_jitter=0.1)
    cam_from_world = draw_viewpoints(config, CAMERA, SIZE, 0.05, seed=1, scene=2, views=50)
    assert poses.is_rotation(cam_from_world[:, :3, :3], 1e-9).all()
    floor = poses.apply(cam_from_world, np.array([[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.0]]]))
    assert np.allclose(floor @ up, up @ origin, atol=1e-9)
    assert np.degrees(np.arctan2(*np.moveaxis(cam_from_world[:, :2, 0], -1, 0))).std() > 50, "bins stand as they like"
    assert math.degrees(max_tilt(config, CAMERA, SIZE)) == pytest.approx(25.0)
    centered = draw_viewpoints(
        ViewpointConfig(cam_from_table=config.cam_from_table), CAMERA, SIZE, 0.05, seed=1, scene=2, views=3
    )
    assert np.allclose(CAMERA.project(centered[:, :3, 3]), [159.5, 119.5])
    assert distance_range(config, CAMERA, SIZE, 0.05) == pytest.approx((pose[2, 3],) * 2)


@pytest.mark.parametrize("name", ["cam_from_table", "table_from_cam"])
def test_a_hand_eye_pose_puts_the_bin_where_it_stood(name: str, tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    pose = TILTED if name == "cam_from_table" else poses.invert(TILTED)
    path.write_text(json.dumps({name: np.round(pose, 6).tolist()}))
    found, turn = read_table(str(path), CAMERA)
    assert np.allclose(found, TILTED, atol=1e-5) and turn < 10
    config = configured(debug(), table=str(path))
    assert config_from_json(config.to_json(), "here") == config
    assert config_from_json(json.loads(json.dumps(config.to_json())), "here") == config
    assert "25° as the table was measured" in config.describe()


def test_a_camera_among_the_parts_is_refused() -> None:
    config = ViewpointConfig(cam_from_table=tuple(map(tuple, TILTED.tolist())))
    require_clear_table(config, SIZE, 0.05)
    with pytest.raises(InputError, match=r"--table: the camera stands .* among the parts"):
        require_clear_table(config, BinSize(0.3, 0.2, 0.6), 0.05)


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("0,0,1", "no such file, nor four numbers"),
        ("0,0,1,far", "give a plane"),
        ("0,0,0,1", "no plane"),
        ("0,0,1,0", "no plane"),
        ("0,0,1,nan", "no plane"),
        ("0,0,1,-0.5", "does not look at that plane"),
        ("1,0,0,0.5", "does not look at that plane"),
        ("0,0,1,700", "700 m away; give meters"),
        ({"plane": [0, 0, 1]}, "4 finite numbers"),
        ({"plane": [0, 0, 1, 0.5], "unit": "mm"}, "one entry and nothing else"),
        ({"pose": np.eye(4).tolist()}, "one entry"),
        ([1, 2], "one entry"),
        ({"cam_from_table": np.eye(4).tolist()}, "below the table"),
        ({"cam_from_table": (2 * TILTED).tolist()}, "no rotation and translation"),
        ({"cam_from_table": TILTED.T.tolist()}, "no rotation and translation"),
        ({"cam_from_table": np.vstack([TILTED[:2], TILTED[2:3] * 1, [[0, 0, 0, 1]]])[:3].tolist()}, "4 x 4 finite"),
    ],
)
def test_what_is_no_table_before_the_camera_is_refused_with_the_mend(
    table: str | dict[str, object] | list[int], sentence: str, tmp_path: Path
) -> None:
    if not isinstance(table, str):
        (tmp_path / "table.json").write_text(json.dumps(table))
        table = str(tmp_path / "table.json")
    with pytest.raises(InputError, match=sentence):
        read_table(table, CAMERA)


def test_the_table_excludes_tilt_and_distance() -> None:
    for other in ({"tilt": "0-10"}, {"distance": "0.4-0.5"}):
        with pytest.raises(InputError, match="leave --tilt and --distance out"):
            configured(debug(), table="0,0,1,0.5", **other)
