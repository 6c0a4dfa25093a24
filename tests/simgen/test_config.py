"""What can be asked for, and what is refused in one sentence."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from evalkit.errors import InputError
from simgen.config import PRESETS, BinSize, BuildConfig, debug, default, default_camera, parse_bin, parse_instances


def test_the_default_is_the_papers() -> None:
    config = default()
    assert (config.scenes, config.views, config.camera.width, config.camera.height) == (2000, 17, 640, 480)
    assert (config.instances_min, config.instances_max) == (10, 20)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_survives_json(preset: str) -> None:
    config = PRESETS[preset]()
    document = config.to_json()
    assert json.loads(json.dumps(document)) == document


@pytest.mark.parametrize("scenes", [1, 7, 20, 21, 2000])
@pytest.mark.parametrize("shard_scenes", [1, 3, 20, 5000])
def test_shards_hold_every_scene_once(scenes: int, shard_scenes: int) -> None:
    config = replace(debug(), scenes=scenes, shard_scenes=shard_scenes)
    held = [scene for shard in range(config.shards) for scene in config.scenes_of_shard(shard)]
    assert held == list(range(scenes))
    assert all(config.scenes_of_shard(shard) for shard in range(config.shards))


@pytest.mark.parametrize(
    ("change", "option"),
    [
        ({"scenes": 0}, "--scenes"),
        ({"views": -1}, "--views"),
        ({"shard_scenes": 0}, "--shard-scenes"),
        ({"instances_min": 20, "instances_max": 10}, "--instances"),
        ({"instances_min": 0}, "--instances"),
        ({"instances_max": 70_000}, "--instances"),
        ({"seed": -1}, "--seed"),
        ({"compression": "lzma"}, "--compression"),
    ],
)
def test_nonsense_is_refused_by_the_name_of_its_option(change: dict[str, object], option: str) -> None:
    with pytest.raises(InputError, match=option):
        replace(debug(), **change)  # type: ignore[arg-type]


def test_instances_are_a_number_or_a_range() -> None:
    assert parse_instances("10-20") == (10, 20)
    assert parse_instances("15") == (15, 15)
    for text in ("", "ten", "1-2-3", "-5", "1.5"):
        with pytest.raises(InputError, match="--instances"):
            parse_instances(text)


def test_a_bin_is_auto_or_three_sides() -> None:
    assert parse_bin("auto") is None
    assert parse_bin("0.4x0.3x0.1") == BinSize(0.4, 0.3, 0.1)
    for text in ("0.4x0.3", "axbxc", "0.4x0.3x0", "0.4x-1x0.1", "nanx1x1", "infx1x1"):
        with pytest.raises(InputError, match="--bin"):
            parse_bin(text)


def test_the_default_camera_looks_straight_ahead() -> None:
    camera = default_camera(320, 240)
    assert (camera.cx, camera.cy) == (159.5, 119.5)
    assert BuildConfig(1, 1, 1, 1, camera).camera.fx == camera.fy
