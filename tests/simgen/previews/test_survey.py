"""The figures of a survey are those of the labels and pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_folder import ShardDataset, shard_name
from evalkit.datasets.shard_format import ShardHeader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.previews.survey import survey
from simgen.previews.survey_charts import survey_charts

CAMERA = Camera(40, 30, 40.0, 40.0, 19.5, 14.5)
MODEL = ObjectModel.from_mesh("bunny", *BUILTIN_OBJECTS["bunny"].make())
FROM_ABOVE = poses.from_rotation_translation(np.diag([1.0, -1.0, -1.0]), [0, 0, 1.0])  # 1 m up, looking down


def view_of(scene: int, view: int, world_from_obj: np.ndarray, visible: list[float]) -> View:
    """Depth 1 m, of which the upper half is instance 0, at 0.9 m; one corner has no return."""
    depth, ids = np.full((30, 40), 10_000, np.uint16), np.zeros((30, 40), np.uint16)
    count = len(world_from_obj)
    if count:
        depth[:15], ids[:15] = 9000, 1
    depth[:3, :4] = 0
    cam_from_obj = FROM_ABOVE @ world_from_obj
    shown = (100 * np.array(visible)).astype(np.int32)
    labels = Instances(
        np.arange(count, dtype=np.int32), cam_from_obj, *np.array([visible, visible], np.float32), shown, shown,
        np.full(count, 100, np.int32), *np.zeros((2, count, 4), np.int32), np.zeros((count, 2), np.float32),
    )  # fmt: skip
    return View(CAMERA, depth, 1e-4, ids, FROM_ABOVE, labels, scene, view)


def dataset_of(folder: Path, views: list[View]) -> ShardDataset:
    with ShardWriter(folder / shard_name(0), ShardHeader(CAMERA, 1e-4, MODEL), len(views)) as writer:
        for view in views:
            writer.append(view)
    return ShardDataset(folder)


@pytest.fixture
def two_scenes(tmp_path: Path) -> ShardDataset:
    """An upright and a lying instance, seen twice; and an instance on its head, seen once."""
    lying = poses.from_axis_angle([1.0, 0, 0], np.pi / 2)
    first = poses.from_rotation_translation(np.stack([np.eye(3), lying]), np.zeros((2, 3)))
    second = poses.from_rotation_translation(poses.from_axis_angle([1.0, 0, 0], np.pi), np.zeros(3))[None]
    frames = [view_of(0, 0, first, [1.0, 0.2]), view_of(0, 1, first, [0.6, 0.0]), view_of(1, 0, second, [0.9])]
    return dataset_of(tmp_path, frames)


def test_labels_are_counted_in_every_frame_and_instances_in_every_scene(two_scenes: ShardDataset) -> None:
    found = survey(two_scenes, [0, 1, 2])
    assert sorted(found.visibility) == pytest.approx([0.0, 0.2, 0.6, 0.9, 1.0])
    assert found.instances.tolist() == [2, 1]
    assert found.clear.tolist() == [1, 1, 1]


def test_depth_counts_every_pixel_with_a_return_once(two_scenes: ShardDataset) -> None:
    found = survey(two_scenes, [0, 2])
    assert found.on_instances.sum() == 2 * (15 * 40 - 12)
    assert found.elsewhere.sum() == 2 * 15 * 40
    assert found.no_return == pytest.approx(12 / 1200)
    bins = np.digitize([0.9, 1.0], found.depth_edges) - 1
    assert found.on_instances[bins[0]] == found.on_instances.sum()
    assert found.elsewhere[bins[1]] == found.elsewhere.sum()
    assert (np.diff(found.depth_edges) > 0).all()


def test_each_scene_tells_once_how_its_instances_lie(two_scenes: ShardDataset) -> None:
    assert np.degrees(survey(two_scenes, [0, 1, 2]).axis_from_up) == pytest.approx([0, 90, 180], abs=1e-4)


def test_an_upright_instance_is_seen_from_its_top_and_hidden_ones_from_nowhere(two_scenes: ShardDataset) -> None:
    directions = survey(two_scenes, [0]).directions
    assert len(directions) == 4
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(4))
    assert directions[0, 2] > 0.99 and directions[3, 2] < -0.99
    assert directions[1, 1] > 0.99  # turned by 90 degrees about x, its y looks up


def test_charts_hold_the_same_numbers_as_the_survey(two_scenes: ShardDataset) -> None:
    charts = {chart.name: chart for chart in survey_charts(survey(two_scenes, [0, 1, 2]), "none")}
    assert set(charts) == {"visibility", "instances", "depth", "tilt", "directions"}
    assert sum(row[2] for row in charts["visibility"].rows) == 5
    assert [sum(row[k] for row in charts["instances"].rows) for k in (2, 3)] == [2, 3]
    assert sum(row[2] for row in charts["tilt"].rows) == 3
    assert sum(row[3] for row in charts["tilt"].rows) == pytest.approx(3)
    assert sum(row[4] for row in charts["directions"].rows) == 4


@pytest.mark.parametrize("depth", [0, 9000])
def test_frames_without_instances_or_returns_are_drawn_too(tmp_path: Path, depth: int) -> None:
    empty = view_of(0, 0, np.zeros((0, 4, 4)), [])
    empty.depth_raw[:] = depth
    found = survey(dataset_of(tmp_path, [empty]), [0])
    assert found.no_return == (depth == 0)
    for chart in survey_charts(found, "none"):
        assert b"<svg" in chart.svg()
