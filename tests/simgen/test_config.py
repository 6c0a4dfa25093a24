"""What can be asked for, and what is refused in one sentence."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest

from evalkit.errors import InputError
from simgen.commands.parsing import parse_bin, parse_instances, parse_range
from simgen.config import BuildConfig
from simgen.config_sections import BinSize, DistractorConfig, PileConfig, ViewpointConfig
from simgen.presets import PRESETS, debug, default, default_camera, paper, sileane
from simgen.sensors.sensor_config import stereo


def test_the_papers_set_has_a_preset_and_the_default_is_half_of_it() -> None:
    config = paper()
    assert (config.scenes, config.views, config.camera.width, config.camera.height) == (2000, 17, 640, 480)
    assert (config.instances_min, config.instances_max) == (10, 20)
    assert default() == replace(config, scenes=1000)


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


@pytest.mark.parametrize("preset", ["default", "demo", "debug"])
def test_the_papers_presets_draw_nothing_but_the_cap(preset: str) -> None:
    config = PRESETS[preset]()
    assert config.pile == PileConfig()
    assert config.viewpoints == ViewpointConfig()
    assert (config.pile.bin_jitter, config.pile.wall_probability, config.viewpoints.look_at_jitter) == (0, 1, 0)


def test_sileanes_camera_is_that_of_its_bunny_scenes() -> None:
    camera = sileane().camera
    assert (camera.width, camera.height, camera.fx, camera.cx, camera.cy) == (506, 474, 1152.31, 139.459, 237.001)
    assert (sileane().instances_min, sileane().instances_max) == (20, 80)


@pytest.mark.parametrize(
    ("kind", "change", "option"),
    [
        (ViewpointConfig, {"max_tilt_degrees": 89.0}, "--tilt"),
        (ViewpointConfig, {"min_tilt_degrees": 40.0}, "--tilt"),
        (ViewpointConfig, {"nearest": 2.0}, "--distance"),
        (ViewpointConfig, {"look_at_jitter": 0.6}, "--look-at-jitter"),
        (PileConfig, {"bin_jitter": -0.1}, "--bin-jitter"),
        (PileConfig, {"wall_probability": 1.1}, "--walls"),
        (PileConfig, {"wall_probability": float("nan")}, "--walls"),
    ],
)
def test_what_is_random_has_bounds(kind: type, change: dict[str, float], option: str) -> None:
    with pytest.raises(InputError, match=option):
        kind(**change)


def test_a_range_is_a_number_or_two_in_order() -> None:
    assert parse_range("--tilt", "10-60") == (10, 60)
    assert parse_range("--tilt", "0.5 - 1.25") == (0.5, 1.25)
    assert parse_range("--tilt", "7") == (7, 7)
    for text in ("", "steep", "1-2-3", "-5", "9-8", "nan"):
        with pytest.raises(InputError, match="--tilt"):
            parse_range("--tilt", text)


def with_one_changed(config: Any) -> Iterator[tuple[str, Any]]:
    """The same dataclass with each of its values, those of nested ones too, changed by itself."""
    for entry in fields(config):
        value = getattr(config, entry.name)
        if entry.name == "rules":  # of which there is one value
            continue
        if is_dataclass(value):
            yield from (
                (f"{entry.name}.{name}", replace(config, **{entry.name: v})) for name, v in with_one_changed(value)
            )
        else:
            yield entry.name, replace(config, **{entry.name: changed(value)})


def changed(value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return {"zstd": "gzip", "cpu": "pyrender", "pybullet": "rapier"}.get(value, "another")
    if value is None:  # the only pose: of a measured table
        return ((1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.5), (0.0, 0.0, 0.0, 1.0))
    if isinstance(value, tuple):
        return ("another",) * len(value)
    if isinstance(value, int):
        return value - 1 if value > 1 else value + 1
    return value * 0.98 if value else 0.01


def test_every_value_is_told() -> None:
    things = DistractorConfig(("builtin",), ("",), 0.3)
    config = replace(sileane(), bin=BinSize(0.4, 0.3, 0.1), sensor=stereo(), distractors=things)
    for name, other in with_one_changed(config):
        assert other.describe() != config.describe(), name


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_survives_the_dataset_file(preset: str) -> None:
    document = PRESETS[preset]().to_json()
    assert json.loads(json.dumps(document)) == document
