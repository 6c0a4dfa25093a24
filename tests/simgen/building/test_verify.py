"""Sound shards pass; whatever is changed in one is found and named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_folder import DATASET_FILE, shard_name, write_dataset_file
from evalkit.datasets.shard_format import SCHEMA, ShardHeader, seal
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.building.verify import verify_shards
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.rendering.labels import label_instances, quantized
from simgen.rendering.rasterizer import Rasterizer

CAMERA = Camera(96, 72, 90.0, 90.0, 47.5, 35.5)
MODEL = ObjectModel.from_mesh("bunny", *BUILTIN_OBJECTS["bunny"].make())
UNIT = 1e-4
SCENES, VIEWS = 2, 2


def views_of(scene: int) -> list[View]:
    """Some bunnies seen from two places, one of them out of sight."""
    rng = np.random.default_rng(scene)
    position = np.column_stack([rng.uniform(-0.1, 0.1, (5, 2)), rng.uniform(0.3, 0.4, 5)])
    position[4] = [3.0, 0.0, 0.4]
    world_from_obj = poses.from_rotation_translation(poses.random_rotations(rng, 5), position)
    assert MODEL.vertices is not None and MODEL.faces is not None
    rasterizer = Rasterizer(CAMERA, MODEL.vertices, MODEL.faces)
    views = []
    for view in range(VIEWS):
        cam_from_world = poses.from_rotation_translation(poses.from_axis_angle([0, 1, 0], 0.1 * view), [0, 0, 0.05])
        rendering = rasterizer.render(cam_from_world @ world_from_obj, cam_from_world)
        depth = quantized(rendering.depth, UNIT)
        depth[::7, ::5] = 0  # some pixels give no return
        labels = label_instances(rendering, depth, cam_from_world @ world_from_obj, MODEL, CAMERA)
        views.append(View(CAMERA, depth, UNIT, rendering.instance_id, cam_from_world, labels, scene, view))
    return views


SCENE_VIEWS = [views_of(scene) for scene in range(SCENES)]


def write(folder: Path, config: dict[str, object], scene_views: list[list[View]], keep_ideal: bool = False) -> Path:
    """A dataset of one scene a shard."""
    header = ShardHeader(CAMERA, UNIT, MODEL, config, seed=1)
    for scene, views in enumerate(scene_views):
        with ShardWriter(folder / shard_name(scene), header, VIEWS, keep_ideal=keep_ideal) as writer:
            for view in views:
                writer.append(view)
    listed = [{"name": shard_name(scene), "scenes": [scene, scene + 1]} for scene in range(SCENES)]
    write_dataset_file(folder, header, listed)
    return folder


@pytest.fixture
def shards(tmp_path: Path) -> Path:
    return write(tmp_path, {"scenes": SCENES}, SCENE_VIEWS)


def noisy(view: View) -> View:
    """The view with one return in five of every instance far off, as at edges, and the depth without these."""
    depth = view.depth_raw.copy()
    depth[::5][(depth[::5] > 0) & (view.instance_id[::5] > 0)] += 3000
    return replace(view, depth_raw=depth, depth_ideal_raw=view.depth_raw)


@pytest.fixture(params=[True, False], ids=["ideal kept", "ideal not kept"])
def noisy_shards(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    views = [[noisy(view) for view in views] for views in SCENE_VIEWS]
    return write(tmp_path, {"sensor": {"model": "stereo"}}, views, keep_ideal=request.param)


def change(path: Path, edit: Callable[[h5py.File], None]) -> None:
    """Change a shard and seal it again, so that only its labels are wrong."""
    with h5py.File(path, "r+") as file:
        edit(file)
    seal(path, SCHEMA)


def set_value(name: str, place: object, value: object) -> Callable[[h5py.File], None]:
    def edit(file: h5py.File) -> None:
        data = file[name][()]
        data[place] = value
        file[name][...] = data

    return edit


def test_sound_shards_have_no_problem(shards: Path) -> None:
    report = verify_shards(shards)
    assert report.problems == []
    assert (report.shards, report.frames, len(report.scenes)) == (SCENES, SCENES * VIEWS, SCENES)
    assert f"{SCENES * VIEWS * 5} labeled instances" in report.summary
    assert "all checksums and label laws hold" in report.summary


def test_one_shard_can_be_verified_alone(shards: Path) -> None:
    assert verify_shards(shards / shard_name(1)).frames == VIEWS


def shift_pixels(file: h5py.File) -> None:
    ids = file["instance_id"][()]
    ids[1] = np.where(ids[1] == 2, 3, ids[1])
    file["instance_id"][...] = ids


def raise_depth(file: h5py.File) -> None:
    ids, depth = file["instance_id"][1], file["depth"][()]
    v, u = np.argwhere((ids == 1) & (depth[1] > 0))[0]
    depth[1, v, u] += 2000
    file["depth"][...] = depth


ROW = 5  # the first instance of frame 1
LABEL_CHANGES: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "visibility above one": (set_value("visibility_returned", ROW, 1.5), "visibility_returned of instance 0"),
    "visibility not a number": (set_value("visibility_geometric", ROW, np.nan), "visibility_geometric of instance 0"),
    "visibility slightly off": (set_value("visibility_returned", ROW, 0.123), "visibility_returned of instance 0"),
    "a visible pixel too many": (set_value("pixels_geometric", ROW + 1, 1), "pixels_geometric of instance 1"),
    "a returned pixel too many": (set_value("pixels_returned", ROW + 1, 1), "pixels_returned of instance 1"),
    "more visible than there are": (set_value("pixels_full", ROW, 1), "more visible pixels"),
    "a loose box": (set_value("box_returned", (ROW, 0), 0), "box_returned of instance 0"),
    "a box for what is hidden": (set_value("box_returned", ROW + 4, [1, 1, 5, 5]), "box_returned of instance 4"),
    "a full box too small": (set_value("box_full", ROW, [0, 0, 1, 1]), "box_full of instance 0"),
    "a center elsewhere": (set_value("center_px", (ROW + 2, 0), 3.0), "center_px of instance 2"),
    "a center not a number": (set_value("center_px", (ROW + 2, 0), np.nan), "center_px of instance 2"),
    "a pose that is not rigid": (set_value("cam_from_obj", (ROW, 0, 0), 2.0), "cam_from_obj of instance 0"),
    "a pose not a number": (set_value("cam_from_obj", (ROW, 0, 3), np.nan), "cam_from_obj of instance 0"),
    "a camera that is not rigid": (set_value("cam_from_world", (1, 3, 0), 1.0), "cam_from_world"),
    "a camera elsewhere": (set_value("cam_from_world", (1, 0, 3), 0.5), "where the scene's first view"),
    "an instance twice": (set_value("instance", ROW + 1, 0), "two labels"),
    "an instance that does not fit": (set_value("instance", ROW + 1, 70000), "16 bits"),
    "an unknown id": (set_value("instance_id", (1, 0, 0), 99), "instance_id holds 99"),
    "pixels of another instance": (shift_pixels, "pixels_geometric of instance 1"),
    "depth far off the instance": (raise_depth, "outside its bounding sphere"),
}


@pytest.mark.parametrize("case", LABEL_CHANGES)
def test_a_broken_label_is_named_with_shard_and_frame(shards: Path, case: str) -> None:
    edit, words = LABEL_CHANGES[case]
    change(shards / shard_name(1), edit)
    report = verify_shards(shards)
    assert report.problems
    assert any(words in problem.sentence for problem in report.problems), report.problems
    assert {(problem.shard, problem.frame) for problem in report.problems} == {(shard_name(1), 1)}
    assert f"{len(report.problems)} problem" in report.summary


def test_outliers_of_a_sensor_are_no_problem(noisy_shards: Path) -> None:
    assert verify_shards(noisy_shards).problems == []


def test_outliers_where_no_sensor_was_asked_for_are_a_problem(tmp_path: Path) -> None:
    folder = write(tmp_path, {"sensor": None}, [[noisy(view) for view in views] for views in SCENE_VIEWS])
    problems = verify_shards(folder).problems
    assert problems and all("outside its bounding sphere" in problem.sentence for problem in problems)


def test_noisy_depth_of_quite_another_place_is_found(noisy_shards: Path) -> None:
    def move(file: h5py.File) -> None:
        depth = file["depth"][()]
        depth[1][depth[1] > 0] += 3000
        file["depth"][...] = depth

    change(noisy_shards / shard_name(1), move)
    (problem,) = verify_shards(noisy_shards).problems
    assert problem.frame == 1 and problem.sentence.startswith("depth at the pixels of instance")


@pytest.mark.parametrize(
    ("value", "words"), [(0, "where depth_ideal has nothing"), (9000, "depth_ideal at the pixels")]
)
def test_ideal_depth_is_held_to_the_geometry_pixel_by_pixel(tmp_path: Path, value: int, words: str) -> None:
    views = [[noisy(view) for view in views] for views in SCENE_VIEWS]
    folder = write(tmp_path, {"sensor": {"model": "stereo"}}, views, keep_ideal=True)

    def edit(file: h5py.File) -> None:
        ideal = file["depth_ideal"][()]
        v, u = np.argwhere((file["instance_id"][1] > 0) & (ideal[1] > 0))[0]
        ideal[1, v, u] = value
        file["depth_ideal"][...] = ideal

    change(folder / shard_name(1), edit)
    (problem,) = verify_shards(folder).problems
    assert problem.frame == 1 and words in problem.sentence


def test_a_sealed_shard_with_too_few_ideal_frames_is_found(tmp_path: Path) -> None:
    views = [[noisy(view) for view in views] for views in SCENE_VIEWS]
    folder = write(tmp_path, {"sensor": {"model": "stereo"}}, views, keep_ideal=True)

    def edit(file: h5py.File) -> None:
        ideal = file["depth_ideal"][:1]
        del file["depth_ideal"]
        file["depth_ideal"] = ideal

    change(folder / shard_name(0), edit)
    assert any("depth_ideal holds 1 frames" in problem.sentence for problem in verify_shards(folder).problems)


@pytest.mark.parametrize("offset", [[0, 5, 9], [1, 5, 10], [0, 11, 10]])
def test_labels_that_do_not_divide_among_the_frames_are_found(shards: Path, offset: list[int]) -> None:
    change(shards / shard_name(0), set_value("frame_offset", slice(None), offset))
    (problem,) = verify_shards(shards).problems
    assert "frame_offset" in problem.sentence and problem.shard == shard_name(0)


@pytest.mark.parametrize("place", [0.02, 0.3, 0.6, 0.98])
def test_a_single_changed_byte_is_found(shards: Path, place: float) -> None:
    path = shards / shard_name(0)
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 0x10
    path.write_bytes(bytes(data))
    report = verify_shards(shards)
    assert {problem.shard for problem in report.problems} == {shard_name(0)}
    assert any("checksum" in problem.sentence for problem in report.problems)


def test_a_truncated_shard_is_found_and_the_others_are_still_verified(shards: Path) -> None:
    path = shards / shard_name(0)
    path.write_bytes(path.read_bytes()[:3000])
    report = verify_shards(shards)
    assert {problem.shard for problem in report.problems} == {shard_name(0)}
    assert report.frames == VIEWS


def test_missing_and_foreign_shards_are_named(shards: Path) -> None:
    (shards / shard_name(0)).rename(shards / shard_name(7))
    problems = {problem.shard: problem.sentence for problem in verify_shards(shards).problems}
    assert "missing" in problems[shard_name(0)]
    assert "does not belong" in problems[shard_name(7)]


def test_an_image_in_two_shards_is_found(shards: Path) -> None:
    (shards / shard_name(1)).write_bytes((shards / shard_name(0)).read_bytes())
    sentences = [problem.sentence for problem in verify_shards(shards).problems]
    assert any("already" in sentence for sentence in sentences)
    assert any("scenes beyond" in sentence for sentence in sentences)


def test_a_shard_of_another_build_is_found(shards: Path) -> None:
    document = json.loads((shards / DATASET_FILE).read_text())
    document["config"]["scenes"] = 99
    (shards / DATASET_FILE).write_text(json.dumps(document))
    assert {"config" in problem.sentence for problem in verify_shards(shards).problems} == {True}


def test_nothing_to_verify_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no shards"):
        verify_shards(tmp_path)
    with pytest.raises(InputError, match="no such"):
        verify_shards(tmp_path / "missing")


def test_a_frame_without_instances_is_sound(tmp_path: Path) -> None:
    empty = View(
        CAMERA,
        np.zeros((72, 96), np.uint16),
        UNIT,
        np.zeros((72, 96), np.uint16),
        np.eye(4),
        SCENE_VIEWS[0][0].instances[:0],
        0,
        0,
    )
    assert isinstance(empty.instances, Instances)
    with ShardWriter(tmp_path / shard_name(0), ShardHeader(CAMERA, UNIT, MODEL), 1) as writer:
        writer.append(empty)
    assert verify_shards(tmp_path).problems == []
