"""Whole datasets: the same bytes whoever builds them, and nothing lost when a build is cut short."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from angle_job import SMALL, digests, job_of, times
from click.testing import CliRunner, Result
from numpy.typing import NDArray

from evalkit.datasets.shard_folder import ShardDataset, read_dataset_file, shard_name
from evalkit.datasets.shard_format import checksum_problem
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.building.build import build, build_shard
from simgen.commands.cli import cli
from simgen.config_sections import BinSize, PileConfig
from simgen.physics.distribution import bullet_version
from simgen.presets import PRESETS, default_camera
from simgen.scenes.job import Job
from simgen.scenes.plan import depth_unit_for
from simgen.scenes.render import SceneRenderer
from simgen.scenes.simulate import make_scene


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built") / "shards"
    with contextlib.redirect_stderr(io.StringIO()):
        build(job_of(), folder, workers=2)
    return folder


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "copy"
    folder.mkdir()
    for path in built.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def test_the_number_of_workers_does_not_show(built: Path, tmp_path: Path) -> None:
    build(job_of(), tmp_path / "one", workers=1)
    assert digests(tmp_path / "one") == digests(built)
    build_shard(job_of(), tmp_path, 1)
    assert digests(tmp_path)[shard_name(1)] == digests(built)[shard_name(1)]


def test_every_scene_and_view_is_there_once_and_in_order(built: Path) -> None:
    frames = [(view.scene_index, view.view_index) for view in ShardDataset(built)]
    assert frames == [(scene, view) for scene in range(5) for view in range(2)]
    assert all(checksum_problem(path) is None for path in built.glob("shard-*.h5"))


def test_labels_obey_their_laws(built: Path) -> None:
    for view in ShardDataset(built):
        labels = view.instances
        assert 2 <= len(labels) <= 4
        assert poses.is_rotation(labels.cam_from_obj[:, :3, :3], 1e-9).all()
        visibility = labels.visibility("geometric")
        assert (visibility >= 0).all() and (visibility <= 1).all()
        visible = np.bincount(view.instance_id[view.depth_raw > 0], minlength=len(labels) + 1)[1:]
        assert np.array_equal(visible, labels.pixels_returned)
        assert np.array_equal(visible, labels.pixels_geometric), "no sensor loses any"
        assert visibility.max() > 0.5, "something lies on top"
        assert (view.depth_raw > 0).mean() > 0.95, "the bin and the ground give depth"


def test_the_header_tells_how_it_was_made(built: Path) -> None:
    header = ShardDataset(built).header
    assert header.config["scenes"] == 5 and header.config["bin"]["width"] > 0.1
    assert header.software.keys() >= {"binpose-simgen", *bullet_version(), "numpy"} and bullet_version()
    assert header.object.name == "angle" and header.depth_unit == 1e-4
    assert read_dataset_file(built)["shards"][-1] == {"name": shard_name(2), "scenes": [4, 5]}


def test_a_complete_folder_is_left_alone(copy: Path) -> None:
    before = times(copy)
    report = build(job_of(), copy, workers=2)
    assert (report.kept, report.written) == (3, [])
    assert times(copy) == before


def test_only_missing_and_damaged_shards_are_built(copy: Path, built: Path) -> None:
    (copy / shard_name(0)).unlink()
    spoiled = bytearray((copy / shard_name(2)).read_bytes())
    spoiled[len(spoiled) // 2] ^= 1
    (copy / shard_name(2)).write_bytes(spoiled)
    (copy / f".{shard_name(1)}.abc.tmp").write_bytes(b"half")
    before = times(copy)
    report = build(job_of(), copy, workers=1)
    assert report.damaged == [shard_name(2)] and [shard.shard for shard in report.written] == [0, 2]
    assert times(copy)[shard_name(1)] == before[shard_name(1)]
    assert digests(copy) == digests(built)


@pytest.mark.parametrize(
    ("other", "what"),
    [
        (job_of(replace(SMALL, seed=1)), "config.seed is 0 there and 1 here"),
        (job_of(replace(SMALL, bin=BinSize(0.3, 0.3, 0.1))), "config.bin"),
        (job_of(symmetry="cyclic:2"), "object.symmetry.name is none there and cyclic:2 here"),
        (job_of(scale=1.01), "config.bin|geometry|diameter"),
    ],
)
def test_another_dataset_is_refused(copy: Path, other: Job, what: str) -> None:
    before = times(copy)
    with pytest.raises(InputError, match=what):
        build(other, copy, workers=1)
    assert times(copy) == before


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: text.replace('"seed": 0', '"seed": 7'),
        lambda text: text.replace('"views": 2', '"views": NaN'),
        lambda text: text.replace('"scenes": 5', '"scenes": ' + "9" * 5000),
        lambda text: text.replace('"fx": ', '"fx": 1'),
        lambda text: text.replace("shard-00001.h5", "../shard-00001.h5"),
        lambda text: text.replace("binpose-dataset/1", "binpose-dataset/9"),
        lambda text: "[" * 100_000,
        lambda text: "[]",
    ],
    ids=["seed", "NaN", "5000 digits", "camera", "shard elsewhere", "schema", "deep", "list"],
)
def test_an_edited_dataset_file_is_refused_in_one_sentence(copy: Path, edit: Callable[[str], str]) -> None:
    path = copy / "dataset.json"
    edited = edit(path.read_text())
    assert edited != path.read_text()
    path.write_text(edited)
    before = digests(copy)
    with pytest.raises(InputError, match=r"holds another dataset|move the folder away") as error:
        build(job_of(), copy, workers=1)
    assert "\n" not in str(error.value) and str(copy) in str(error.value)
    assert digests(copy) == before


def test_a_shard_under_anothers_name_and_a_link_elsewhere_are_replaced(copy: Path, built: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "mine.h5"
    elsewhere.write_bytes(b"mine")
    (copy / shard_name(0)).unlink()
    (copy / shard_name(0)).symlink_to(elsewhere)
    (copy / shard_name(2)).write_bytes((copy / shard_name(1)).read_bytes())
    assert build(job_of(), copy, workers=1).damaged == [shard_name(0), shard_name(2)]
    assert digests(copy) == digests(built)
    assert elsewhere.read_bytes() == b"mine" and not (copy / shard_name(0)).is_symlink()


def test_shards_of_unknown_origin_are_not_mixed_in(copy: Path) -> None:
    (copy / "dataset.json").unlink()
    with pytest.raises(InputError, match="choose another folder"):
        build(job_of(), copy, workers=1)


def test_scenes_can_be_simulated_one_by_one_in_any_order(built: Path) -> None:
    job = job_of()
    views = [view for view in ShardDataset(built) if view.view_index == 0]
    for index in (3, 0):
        scene, _ = make_scene(job, index)
        cam_from_obj = poses.compose(scene.cam_from_world[0], scene.world_from_obj)
        assert np.array_equal(cam_from_obj, views[index].instances.cam_from_obj)


def test_one_scene_of_a_seed_is_not_another_of_the_next_seed() -> None:
    scenes = [make_scene(job_of(replace(SMALL, seed=seed)), index)[0] for seed in (0, 1) for index in (0, 1)]
    assert len({scene.world_from_obj[0].tobytes() for scene in scenes}) == 4


@pytest.mark.parametrize(("farthest", "diameter", "unit"), [(2, 0.1, 1e-4), (60, 2, 1e-3), (0.05, 2e-3, 1e-6)])
def test_the_depth_unit_suits_the_scene(farthest: float, diameter: float, unit: float) -> None:
    assert depth_unit_for(farthest, diameter) == unit


@pytest.mark.parametrize("scale", [0.02, 20.0])
def test_a_screw_and_a_car_door_give_the_images_a_cup_gives(scale: float, tmp_path: Path) -> None:
    job = job_of(replace(SMALL, scenes=1), scale=scale)
    build_shard(job, tmp_path, 0)
    for view in ShardDataset(tmp_path):
        assert (view.depth_raw > 0).mean() > 0.95
        distance = view.depth[view.depth > 0].min()
        assert job.depth_unit < distance / 2000, "depth must be finer than the scene"


# ---- the command ----


def run(*arguments: str, mesh: str = "bunny") -> Result:
    return CliRunner().invoke(cli, ["build", "--object", mesh, "--preset", "debug", *arguments])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--instances", "20-10"], "--instances 20-10"),
        (["--scenes", "0"], "--scenes 0"),
        (["--scenes", "-3"], "--scenes -3"),
        (["--workers", "0"], "--workers 0"),
        (["--bin", "0.05x0.05x0.05"], "--bin 0.05x0.05x0.05: the object 'bunny' is"),
        (["--bin", "small"], "--bin small"),
        (["--instances", "500", "--bin", "0.2x0.2x0.1"], "500 instances of 'bunny' do not fit"),
        (["--width", "0"], "0 x 120 pixels"),
        (["--camera", "nowhere.json"], "nowhere.json does not exist"),
        (["--camera", __file__], "not a camera file"),
        (["--compression", "lzma"], "--compression lzma"),
        (["--camera", "aside"], "principal point (500, 29.5) lies outside the image"),
        (["--camera", "coarse"], "pixels across"),
        (["--camera", "tele", "--bin", "0.8x0.8x0.2"], "too far for an object of"),
        (["--tilt", "60-20"], "--tilt 60-20"),
        (["--tilt", "20-90"], "--tilt 90"),
        (["--distance", "0"], "--distance 0"),
        (["--distance", "800-1200"], "--distance 800-1200: must be meters"),
        (["--look-at-jitter", "-0.1"], "--look-at-jitter -0.1"),
        (["--bin-jitter", "nan"], "--bin-jitter nan"),
        (["--walls", "2"], "--walls 2"),
        (["--bin", "0.12x0.12x0.1", "--bin-jitter", "0.4"], "less --bin-jitter 0.4: the object 'bunny' is"),
    ],
)
def test_bad_options_get_one_sentence_and_exit_code_2(arguments: list[str], sentence: str, tmp_path: Path) -> None:
    cameras = {
        "aside": Camera(80, 60, 70, 70, 500, 29.5),
        "coarse": Camera(8, 6, 7, 7, 3.5, 2.5),
        "tele": Camera(80, 60, 7900, 7900, 39.5, 29.5),
    }
    for name, camera in cameras.items():
        (tmp_path / name).write_text(json.dumps(camera.to_json()))
    arguments = [str(tmp_path / word) if (tmp_path / word).is_file() else word for word in arguments]
    result = run("-o", str(tmp_path / "out"), *arguments)
    assert result.exit_code == 2
    assert sentence in result.stderr
    *remarks, error = result.stderr.splitlines()
    assert error.startswith("Error: ") and all(line.startswith("Warning: ") for line in remarks)
    assert not (tmp_path / "out").exists()


def test_the_renderer_draws_the_scenes_own_bin() -> None:
    """Whoever renders a scene, alone or after others, finds its walls where the instances found them, or none."""
    pile = PileConfig(bin_jitter=0.3, wall_probability=0.5)
    job = job_of(replace(SMALL, pile=pile, camera=default_camera(800, 600), instances_max=2))
    scenes = [make_scene(job, index)[0] for index in range(5)]
    assert len({job.scene_bin(index).walls for index in range(5)}) == 2
    one = SceneRenderer(job)
    for scene in scenes:
        size = job.scene_bin(scene.index)
        from_above = replace(scene, cam_from_world=looking_down(1.0))
        (view,) = one.views(from_above)
        (alone,) = SceneRenderer(job).views(from_above)
        assert np.array_equal(view.depth_raw, alone.depth_raw)
        edge = np.array([size.width / 2 + 0.015 * max(size.width, size.depth), 0.0, size.height])
        u, v = np.round(job.config.camera.project(poses.apply(looking_down(1.0)[0], edge[None])))[0].astype(int)
        depth = view.depth_raw[v, u] * job.depth_unit
        assert depth == pytest.approx(1.0 - size.height if size.walls else 1.0, abs=1e-3)


def looking_down(height: float) -> NDArray[np.float64]:
    """cam_from_world (1, 4, 4) of a camera straight above the bin's middle."""
    return poses.from_rotation_translation(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, height])[None]


@pytest.mark.parametrize("preset", ["sileane", "icvl"])
def test_presets_say_what_they_draw_and_build(preset: str, tmp_path: Path) -> None:
    result = run(
        "--preset", preset, "--scenes", "2", "--views", "2", "--instances", "8",
        "--workers", "1", "-o", str(tmp_path / "out"), mesh="brick",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "walls in" in result.output and "tilted by" in result.output
    dataset = ShardDataset(tmp_path / "out")
    assert len(dataset) == 4 and dataset.header.camera == PRESETS[preset]().camera
    assert dataset.header.config["viewpoints"]["farthest"] == PRESETS[preset]().viewpoints.farthest


def test_what_is_random_can_be_given_as_options(tmp_path: Path) -> None:
    result = run(
        "--scenes", "1", "--tilt", "10-20", "--distance", "1.2-1.3x", "--look-at-jitter", "0.1", "--bin-jitter", "0.2",
        "--walls", "0", "--workers", "1", "-o", str(tmp_path / "out"), mesh="brick",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    config = ShardDataset(tmp_path / "out").header.config
    assert config["viewpoints"] | {"min_tilt_degrees": 10, "max_tilt_degrees": 20, "nearest": 1.2, "farthest": 1.3,
                                   "look_at_jitter": 0.1} == config["viewpoints"]  # fmt: skip
    assert (config["pile"]["bin_jitter"], config["pile"]["wall_probability"]) == (0.2, 0)


def test_a_file_in_the_folders_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    result = run("-o", str(tmp_path / "out"))
    assert result.exit_code == 2 and "choose a folder with -o" in result.stderr


def test_a_camera_file_and_a_size_exclude_each_other(tmp_path: Path) -> None:
    camera = tmp_path / "camera.json"
    camera.write_text('{"width": 80, "height": 60, "fx": 70, "fy": 70, "cx": 39.5, "cy": 29.5}')
    assert Camera.load(camera).width == 80
    result = run("--camera", str(camera), "--width", "90")
    assert result.exit_code == 2 and "leave --width and --height out" in result.stderr


def test_a_disk_that_takes_no_more_is_reported_in_one_sentence(tmp_path: Path) -> None:
    limited = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)); "
    script = tmp_path / "script.py"
    script.write_text(f"{limited}\nif __name__ == '__main__':\n    from simgen.commands.cli import main\n    main()\n")
    arguments = ["build", "--object", "bunny", "--preset", "debug", "--workers", "1", "-o", str(tmp_path / "out")]
    result = subprocess.run([sys.executable, str(script), *arguments], capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert result.stderr.splitlines()[-1] == f"Error: {tmp_path}/out/shard-00000.h5: File too large."
