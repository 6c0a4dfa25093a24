"""The depth camera's errors: seeded, as large and as frequent as they are said to be, and where they belong."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt, gaussian_filter

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from simgen.building.verify import verify_shards
from simgen.commands.cli import cli
from simgen.sensors import random_fields
from simgen.sensors import sensor as model
from simgen.sensors.sensor import measure, sensor_generator
from simgen.sensors.sensor_config import SENSORS, SensorConfig, kinect, stereo
from simgen.sensors.sensor_text import parse_sensor

CAMERA = Camera(320, 240, 576.0, 560.0, 159.5, 119.5)
PERFECT = SensorConfig("perfect", 0.06, 0.0, 0.0, 1e-4, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0, 89.9)


def flat(z: float = 0.8, tan: float = 0.0) -> NDArray[np.float32]:
    """A plane whose depth on the optical axis is z, turned about the image's vertical: dz/dx = tan."""
    across = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    return np.tile(z / (1 - tan * across), (CAMERA.height, 1)).astype(np.float32)


def box_before_wall(near: float = 0.6, far: float = 0.9) -> NDArray[np.float32]:
    depth = flat(far)
    depth[80:160, 120:200] = near
    return depth


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_sensor_without_errors_changes_nothing() -> None:
    depth = box_before_wall()
    depth[5:9, 5:9] = 0
    assert np.allclose(measure(depth, CAMERA, PERFECT, rng()), depth, atol=2e-6)


@pytest.mark.parametrize("name", SENSORS)
def test_the_generator_alone_decides(name: str) -> None:
    depth, sensor = box_before_wall(), SENSORS[name]()
    first = measure(depth, CAMERA, sensor, sensor_generator(3, 1, 2))
    assert np.array_equal(first, measure(depth, CAMERA, sensor, sensor_generator(3, 1, 2)))
    for other in ((4, 1, 2), (3, 2, 2), (3, 1, 1)):
        assert not np.array_equal(first, measure(depth, CAMERA, sensor, sensor_generator(*other)))


@pytest.mark.parametrize("name", SENSORS)
def test_where_there_is_nothing_nothing_returns(name: str) -> None:
    depth = box_before_wall()
    depth[:, :60] = 0
    assert (measure(depth, CAMERA, SENSORS[name](), rng())[:, :60] == 0).all()
    assert (measure(np.zeros_like(depth), CAMERA, SENSORS[name](), rng()) == 0).all()


@pytest.mark.parametrize("z", [0.5, 1.0, 2.0])
def test_noise_grows_with_the_square_of_the_distance(z: float) -> None:
    told = measure(flat(z), CAMERA, stereo(), rng())
    sigma = (told[told > 0] - z).std()
    assert sigma == pytest.approx(stereo().sigma(CAMERA, z), rel=0.06)
    assert stereo().sigma(CAMERA, z) == pytest.approx(0.065 * z**2 / (576 * 0.06))


@pytest.mark.parametrize("degrees", [30.0, 50.0, 65.0])
def test_noise_grows_with_the_slope(degrees: float) -> None:
    tan = math.tan(math.radians(degrees))
    depth = flat(0.8, tan)
    middle = np.s_[:, 150:170]
    error = (measure(depth, CAMERA, stereo(), rng()) - depth)[middle]
    sigma = error[np.abs(error) < 0.05].std()
    expected = stereo().sigma(CAMERA, 0.8) * (1 + stereo().noise_per_slope * tan)
    assert sigma == pytest.approx(expected, rel=0.12)


def test_noise_is_correlated_as_measured() -> None:
    noise = model.matching_noise((480, 640), rng())
    assert noise.std() == pytest.approx(1, abs=0.02) and noise.mean() == pytest.approx(0, abs=0.03)
    for lag, expected in ((1, 0.63), (2, 0.44), (3, 0.32), (5, 0.17), (20, 0.0)):
        assert np.mean(noise[:, lag:] * noise[:, :-lag]) == pytest.approx(expected, abs=0.04)
        assert np.mean(noise[lag:] * noise[:-lag]) == pytest.approx(expected, abs=0.04)


def test_smooth_surface_has_rare_holes_in_blobs() -> None:
    missing = measure(flat(), CAMERA, stereo(), rng()) == 0
    share = missing.mean()
    assert share == pytest.approx(stereo().smooth_missing, abs=0.007)
    beside = (missing[:, 1:] & missing[:, :-1]).mean() / share
    assert beside > 0.5  # were they salt and pepper it would be `share`


@pytest.mark.parametrize("name", SENSORS)
def test_edges_lose_more_than_smooth_surface(name: str) -> None:
    missing = np.mean([measure(box_before_wall(), CAMERA, SENSORS[name](), rng(i)) == 0 for i in range(20)], axis=0)
    assert missing[90:150, 200:202].mean() > 0.2  # right of the box, where no shadow is
    assert missing[:60].mean() < 0.04


def test_shadows_lie_on_the_left_of_what_is_nearer_and_are_as_wide_as_the_disparities_differ() -> None:
    near, far = 0.6, 0.9
    sensor = replace(PERFECT, shadow_missing=1.0)
    missing = measure(box_before_wall(near, far), CAMERA, sensor, rng()) == 0
    width = CAMERA.fx * sensor.baseline * (1 / near - 1 / far)
    assert missing[100].sum() == pytest.approx(width, abs=1)
    assert missing[100, 119] and not missing[100, 118 - math.ceil(width)]
    assert not missing[100, 120:].any() and not missing[:80].any() and not missing[160:].any()


def test_wrong_patches_tell_the_depth_of_the_other_side_of_a_step() -> None:
    depth, sensor = box_before_wall(), replace(PERFECT, wrong_patches=0.3)
    wrong = np.abs(measure(depth, CAMERA, sensor, rng()) - depth) > 1e-3
    assert np.isin(np.round(measure(depth, CAMERA, sensor, rng())[wrong], 3), np.float32([0.6, 0.9])).all()
    assert 0.03 < wrong[model.distance_to_step(model.disparities(depth, 34.56), 0.5) <= 4].mean() < 0.3
    assert not wrong[:60].any()


@pytest.mark.parametrize("quantum", [1 / 8, 1 / 2])
def test_disparity_comes_in_steps(quantum: float) -> None:
    told = measure(flat(0.8, 0.5), CAMERA, replace(kinect(), quantum_px=quantum), rng())
    steps = CAMERA.fx * kinect().baseline / told[told > 0] / quantum
    assert np.allclose(steps, np.round(steps), atol=1e-3)


def test_the_kinect_resolves_what_was_published() -> None:
    """Khoshelham & Elberink 2012: 2.85 mm between steps at 1 m, an error of 1.4 mm there and about 4 cm at 5 m."""
    camera = Camera(640, 480, 580.0, 580.0, 319.5, 239.5)
    step = 1.0 / (camera.fx * kinect().baseline) * kinect().quantum_px
    assert step == pytest.approx(2.85e-3, rel=0.02)
    assert kinect().sigma(camera, 1.0) == pytest.approx(1.425e-3, rel=0.02)
    assert kinect().sigma(camera, 5.0) == pytest.approx(0.0356, rel=0.02)


def random_surface(seed: int) -> NDArray[np.float32]:
    """Boxes at random depths, some of them holes, 60 x 80."""
    draw = rng(seed)
    depth = np.full((60, 80), 1.0, np.float32)
    for _ in range(12):
        v, u, h, w = draw.integers([0, 0, 1, 1], [50, 70, 30, 30])
        depth[v : v + h, u : u + w] = draw.choice([0.0, *draw.uniform(0.4, 1.2, 5)])
    return depth


@pytest.mark.parametrize("seed", range(4))
def test_shadows_agree_with_a_plain_search(seed: int) -> None:
    disparity = model.disparities(random_surface(seed), 20.0)
    place = np.where(disparity > 0, np.arange(80, dtype=np.float32) - disparity, np.inf).astype(np.float32)
    hidden = [
        [disparity[v, u] > 0 and bool((place[v, u + 1 :] <= place[v, u]).any()) for u in range(80)] for v in range(60)
    ]
    assert np.array_equal(model.shadows(disparity), hidden)


@pytest.mark.parametrize("seed", range(4))
def test_distances_to_steps_agree_with_scipy(seed: int) -> None:
    disparity = model.disparities(random_surface(seed), 20.0)
    beside = np.zeros(disparity.shape, bool)
    across, down = np.abs(np.diff(disparity, axis=1)) > 0.5, np.abs(np.diff(disparity, axis=0)) > 0.5
    beside[:, 1:] |= across
    beside[:, :-1] |= across
    beside[1:] |= down
    beside[:-1] |= down
    expected = np.minimum(distance_transform_cdt(~beside, "chessboard") + 1, model.EDGE_REACH + 1)
    assert np.array_equal(model.distance_to_step(disparity, 0.5), expected)


@pytest.mark.parametrize("deviation", [1.0, 3.1])
def test_blurs_agree_with_scipy(deviation: float) -> None:
    margin = 12
    field = rng().standard_normal((50 + 2 * margin, 40 + 2 * margin), np.float32)
    expected = gaussian_filter(field, deviation, radius=math.ceil(3 * deviation))[margin:-margin, margin:-margin]
    total = np.ones((50, 40), np.float32)
    random_fields._add_blurred(field, random_fields._taps(deviation), margin, np.float32(3.0), total)
    assert np.allclose(total, 1 + 3 * expected, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lidar", "ideal, stereo, kinect or a file"),
        ("ideal,baseline=0.1", "ideal, stereo, kinect or a file"),
        ("", "ideal, stereo, kinect or a file"),
        ("stereo,baseline", "'baseline' needs a number"),
        ("stereo,baseline=wide", "needs a number"),
        ("stereo,base=0.1", "one of baseline, noise_px"),
        ("stereo,model=1", "one of baseline"),
        ("stereo,baseline=-20", "baseline -20 must be"),
        ("stereo,noise_px=nan", "noise_px nan must be"),
        ("kinect,smooth_missing=1.5", "smooth_missing 1.5 must be 0 to 1"),
        ("kinect,quantum_px=0", "quantum_px 0 must be"),
    ],
)
def test_bad_sensors_are_refused_with_the_mend(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        parse_sensor(text)
    assert str(caught.value).startswith("--sensor")


def test_sensors_are_given_by_name_with_changes() -> None:
    assert parse_sensor("ideal") is None
    assert parse_sensor("kinect") == kinect()
    assert parse_sensor(" stereo, baseline = 0.1,noise_px=0.2") == replace(stereo(), baseline=0.1, noise_px=0.2)


def test_every_extreme_that_is_allowed_gives_finite_depth() -> None:
    depth = box_before_wall()
    for most in (False, True):
        values = {}
        for field in fields(SensorConfig):
            if field.name == "model":
                continue
            for value in (1e6, 1e-3, 1.0, 0.0, 90.0, 100.0, 10.0, 1e-4, 0.1):
                try:
                    replace(stereo(), **{field.name: value})
                except InputError:
                    continue
                least_or_most = max if most else min
                values[field.name] = least_or_most(values.get(field.name, value), value)
        told = measure(depth, CAMERA, replace(stereo(), **values), rng())
        assert np.isfinite(told).all() and (told >= 0).all()


def build(out: Path, *arguments: object, code: int = 0) -> str:
    words = ["build", "--object", "brick", "--preset", "debug", "--bin", "0.3x0.3x0.1", "--workers", 1, "-o", out]
    result = CliRunner().invoke(cli, [str(word) for word in (*words, *arguments)])
    assert result.exit_code == code, result.output
    return result.output


def test_a_build_with_a_sensor_is_the_same_bytes_for_any_workers_and_after_an_interruption(tmp_path: Path) -> None:
    arguments = ("--sensor", "stereo", "--keep-ideal")
    output = build(tmp_path / "one", *arguments)
    assert "Sensor stereo: depth noise of" in output and "baseline 0.06" in output
    build(tmp_path / "two", *arguments, "--workers", 2)
    first = {path.name: path.read_bytes() for path in sorted((tmp_path / "one").glob("*.*"))}
    assert first == {path.name: path.read_bytes() for path in sorted((tmp_path / "two").glob("*.*"))}
    (tmp_path / "two" / "shard-00001.h5").unlink()
    build(tmp_path / "two", *arguments)
    assert first == {path.name: path.read_bytes() for path in sorted((tmp_path / "two").glob("*.*"))}
    assert verify_shards(tmp_path / "two").problems == []
    assert "sensor" in build(tmp_path / "two", "--sensor", "kinect", "--keep-ideal", code=2)


def test_a_sensor_changes_returned_visibility_and_no_other_label(tmp_path: Path) -> None:
    build(tmp_path / "ideal")
    build(tmp_path / "real", "--sensor", "kinect", "--keep-ideal")
    assert verify_shards(tmp_path / "real").problems == []
    lost = 0
    for ideal, real in zip(ShardDataset(tmp_path / "ideal"), ShardDataset(tmp_path / "real"), strict=True):
        assert ideal.depth_ideal is None
        assert np.array_equal(real.depth_ideal_raw, ideal.depth_raw)
        assert np.array_equal(real.depth_ideal, ideal.depth)
        assert np.array_equal(real.instance_id, ideal.instance_id)
        assert np.array_equal(real.instances.cam_from_obj, ideal.instances.cam_from_obj)
        assert np.array_equal(real.instances.pixels_full, ideal.instances.pixels_full)
        assert np.array_equal(real.instances.visibility_geometric, ideal.instances.visibility_geometric)
        assert np.array_equal(ideal.instances.visibility_returned, ideal.instances.visibility_geometric)
        for row, instance in enumerate(real.instances.instance):
            seen = np.count_nonzero((real.instance_id == instance + 1) & (real.depth_raw > 0))
            assert seen == real.instances.pixels_returned[row] <= ideal.instances.pixels_returned[row]
            lost += ideal.instances.pixels_returned[row] - seen
    assert lost > 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--keep-ideal",), "--keep-ideal: the depth is ideal already"),
        (("--sensor", "stereo,baseline=5"), "give a shorter baseline, as in --sensor stereo,baseline=0."),
        (("--sensor", "radar"), "--sensor radar: use ideal"),
    ],
)
def test_what_a_sensor_cannot_do_is_refused_before_anything_is_built(
    tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    result = CliRunner().invoke(
        cli, ["build", "--object", "bunny", "--preset", "debug", "-o", str(tmp_path / "x"), *arguments]
    )
    assert result.exit_code == 2 and words in result.output
    assert not (tmp_path / "x").exists()
