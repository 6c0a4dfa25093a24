"""A sensor on disk: what was written comes back, and nothing else is taken for one."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from evalkit.errors import InputError
from simgen.sensors.sensor_config import kinect
from simgen.sensors.sensor_file import FORMAT, read_sensor, write_sensor
from simgen.sensors.sensor_text import parse_sensor


def test_a_sensor_comes_back_as_it_was_written_and_takes_changes(tmp_path: Path) -> None:
    path, sensor = tmp_path / "sensor.json", replace(kinect(), model="mine", baseline=-0.05, depth_step=1e-3)
    write_sensor(path, sensor, {"frames": 3})
    assert read_sensor(path) == sensor == parse_sensor(str(path))
    assert parse_sensor(f"{path},noise_px=0.5") == replace(sensor, noise_px=0.5)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "binpose-sensor/2"}, "its format is 'binpose-sensor/2', not 'binpose-sensor/1'"),
        ({"format": None}, "its format is None"),
        ({"lens": 1}, "the field lens is unknown"),
        ({"sensor": None}, "expected an object"),
        ({"sensor": {"model": "mine"}}, "is missing, but needed"),
        ({"sensor": asdict(kinect()) | {"haze": 1.0}}, "'haze' is unknown"),
        ({"sensor": asdict(kinect()) | {"noise_px": "much"}}, "noise_px"),
        ({"sensor": asdict(kinect()) | {"noise_px": -1.0}}, "noise_px -1 must be"),
    ],
)
def test_other_files_are_refused_in_one_sentence(change: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "sensor.json"
    path.write_text(json.dumps({"format": FORMAT, "sensor": asdict(kinect()), "fit": {}} | change))
    with pytest.raises(InputError, match=sentence) as caught:
        parse_sensor(str(path))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_missing_files_and_documents_of_others_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such sensor file"):
        parse_sensor(str(tmp_path / "none.json"))
    (tmp_path / "list.json").write_text("[1]")
    with pytest.raises(InputError, match="its format is None"):
        parse_sensor(str(tmp_path / "list.json"))
