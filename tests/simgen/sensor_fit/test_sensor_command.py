"""`simgen sensor fit`, as a stranger types it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from simgen.commands.cli import cli
from simgen.sensor_fit import fit
from simgen.sensors.sensor import measure, sensor_generator
from simgen.sensors.sensor_config import stereo
from simgen.sensors.sensor_text import parse_sensor

Image = NDArray[np.float32]


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, ["sensor", "fit", *map(str, words)])


def write(folder: Path, depths: Sequence[Image], camera: Camera) -> Path:
    folder.mkdir()
    for number, depth in enumerate(depths):
        cv2.imwrite(str(folder / f"{number}.png"), np.rint(depth * 1e4).astype(np.uint16))
    (folder / "camera.json").write_text(json.dumps(camera.to_json() | {"depth_scale": 0.1}))
    return folder


def test_images_become_a_sensor_and_a_page(
    heaps: list[Image], camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "BLURS", (0.5, 1.0))
    monkeypatch.setattr(fit, "LAST_ROUNDS", 2)
    depths = [measure(depth, camera, stereo(), sensor_generator(4, i, 0)) for i, depth in enumerate(heaps[:3])]
    folder, out = write(tmp_path / "frames", depths, camera), tmp_path / "mine.json"
    result = run(folder, "--camera", folder / "camera.json", "--baseline", 0.06, "-o", out)
    assert result.exit_code == 0, result.output
    assert "Sensor mine: depth noise of" in result.output and "figures agree" in result.output
    found = parse_sensor(str(out))
    assert found is not None and found.baseline == 0.06 and found.noise_px == pytest.approx(0.065, rel=0.3)
    assert json.loads(out.read_text())["fit"]["frames"] == ["0", "1", "2"]
    assert "<h1>mine</h1>" in (tmp_path / "mine.html").read_text()


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("few", "at least 3"),
        ("sizes", "pixels but the camera says"),
        ("empty", "is empty or nearly so"),
        ("saturated", "'2' is empty or nearly so"),
        ("name", "ends in .json"),
        ("baseline", "--baseline 0: give meters"),
    ],
)
def test_what_no_sensor_can_be_fitted_to_gets_one_sentence(
    fault: str, sentence: str, heaps: list[Image], camera: Camera, tmp_path: Path
) -> None:
    depths = {
        "few": heaps[:2],
        "sizes": [*heaps[:2], heaps[2][:100]],
        "empty": [*heaps[:2], 0 * heaps[2]],
        "saturated": [*heaps[:2], np.full_like(heaps[2], 6.5535)],
    }.get(fault, heaps)
    out = tmp_path / ("sensor.txt" if fault == "name" else "sensor.json")
    words = [write(tmp_path / "frames", depths, camera), "-o", out, *(["--baseline", 0] if fault == "baseline" else [])]
    result = run(*words)
    assert result.exit_code == 2, result.output
    assert sentence in result.stderr and result.stderr.rstrip().splitlines()[-1].startswith("Error: ")
    assert not out.exists() and not (tmp_path / "sensor.html").exists()
