"""The contact sheet shows what the shards hold."""

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
from evalkit.objects.symmetry import Symmetry
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.previews.sheet import AXIS_COLORS, SYMMETRY_COLOR, contact_sheet, draw_axes, instance_colors, spread_frames

CAMERA = Camera(80, 60, 80.0, 80.0, 39.5, 29.5)
MODEL = ObjectModel.from_mesh("bunny", *BUILTIN_OBJECTS["bunny"].make())


def labeled_view(scene: int, view: int, visibility: float = 0.75) -> View:
    """One instance as a block of pixels, another one hidden; depth with a hole."""
    depth, ids = np.full((60, 80), 5000, np.uint16), np.zeros((60, 80), np.uint16)
    depth[20:40, 30:50], ids[20:40, 30:50] = 4000, 1
    depth[:5, :5] = 0
    cam_from_obj = poses.from_rotation_translation(np.stack([np.eye(3)] * 2), [[0, 0, 0.4], [0, 0, 0.5]])
    labels = Instances(
        instance=np.array([0, 1], np.int32),
        cam_from_obj=cam_from_obj,
        visibility_geometric=np.array([visibility, 0], np.float32),
        visibility_returned=np.array([visibility, 0], np.float32),
        pixels_geometric=np.array([400, 0], np.int32),
        pixels_returned=np.array([400, 0], np.int32),
        pixels_full=np.array([int(400 / visibility), 300], np.int32),
        box_returned=np.array([[30, 20, 50, 40], [0, 0, 0, 0]], np.int32),
        box_full=np.array([[30, 20, 50, 40], [30, 20, 50, 40]], np.int32),
        center_px=CAMERA.project(MODEL.centers(cam_from_obj)).astype(np.float32),
    )
    return View(CAMERA, depth, 1e-4, ids, np.eye(4), labels, scene, view)


def dataset_of(folder: Path, scenes: int, views: int) -> ShardDataset:
    with ShardWriter(folder / shard_name(0), ShardHeader(CAMERA, 1e-4, MODEL), scenes * views) as writer:
        for scene in range(scenes):
            for view in range(views):
                writer.append(labeled_view(scene, view))
    return ShardDataset(folder)


def test_a_sheet_writes_depth_in_millimeters_and_every_visibility(tmp_path: Path) -> None:
    figure = contact_sheet(dataset_of(tmp_path, 2, 1), [0, 1])
    assert len(figure.axes) == 2 * 4  # three pictures and a color bar a row
    depth = figure.axes[0].images[0]
    shown = np.asarray(depth.get_array(), float)
    assert shown[30, 40] == pytest.approx(400.0) and shown[50, 60] == pytest.approx(500.0)
    assert np.isnan(shown[2, 2])
    low, high = depth.get_clim()
    assert low <= 400.0 <= high
    assert any("mm" in axes.get_ylabel() for axes in figure.axes)
    written = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert written == {"0.75"}
    assert any("1 hidden" in axes.get_title(loc="left") for axes in figure.axes)


def test_instances_are_drawn_in_their_own_color(tmp_path: Path) -> None:
    figure = contact_sheet(dataset_of(tmp_path, 1, 1), [0])
    picture = np.asarray(figure.axes[1].images[0].get_array(), float)
    hue = instance_colors(2)[0]
    assert np.corrcoef(picture[30, 40], hue)[0, 1] > 0.95
    assert np.ptp(picture[55, 70]) < 0.05  # the background is gray


@pytest.mark.parametrize(("scenes", "views", "count"), [(5, 3, 4), (2, 3, 4), (1, 2, 5), (6, 1, 6), (3, 2, 1)])
def test_frames_are_of_as_many_scenes_as_there_are(tmp_path: Path, scenes: int, views: int, count: int) -> None:
    dataset = dataset_of(tmp_path, scenes, views)
    frames = spread_frames(dataset, count)
    assert len(set(frames)) == len(frames) == min(count, scenes * views)
    assert len({dataset[frame].scene_index for frame in frames}) == min(count, scenes)


def colors_drawn(model: ObjectModel, pose: np.ndarray) -> set[tuple[int, ...]]:
    picture = np.zeros((60, 80, 3), np.uint8)
    draw_axes(picture, CAMERA, model, pose)
    return {tuple(int(c) for c in pixel) for pixel in picture.reshape(-1, 3)}


def test_axes_and_the_symmetry_axis_are_drawn_in_their_colors() -> None:
    pose = poses.from_rotation_translation(poses.from_axis_angle([1, 2, 3], 1.0), [0, 0, 0.3])
    assert set(AXIS_COLORS) <= colors_drawn(MODEL, pose)
    assert SYMMETRY_COLOR not in colors_drawn(MODEL, pose)
    round_model = MODEL.with_symmetry(Symmetry.parse("revolution"))
    assert {*AXIS_COLORS, SYMMETRY_COLOR} <= colors_drawn(round_model, pose)


@pytest.mark.parametrize("z", [-0.3, 0.0, 0.01])
def test_axes_behind_the_camera_are_left_out(z: float) -> None:
    pose = poses.from_rotation_translation(np.eye(3), [0, 0, z])
    colors_drawn(MODEL.with_symmetry(Symmetry.parse("revolution")), pose)


def test_colors_of_neighbors_differ() -> None:
    colors = instance_colors(300)
    assert ((colors >= 0) & (colors <= 1)).all()
    assert np.abs(np.diff(colors, axis=0)).max(1).min() > 0.2
