"""Outlines over depth: where they lie, and that nothing strange breaks them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evalkit import InputError
from evalkit.drawing.overlays import BLUE, GREEN, RED, draw_poses, shade, silhouette
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

CAMERA = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)


def model(splits=1):
    """A square of 0.1 m, of 2 splits^2 triangles."""
    ticks = np.linspace(-0.05, 0.05, splits + 1)
    x, y = np.meshgrid(ticks, ticks)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    corner = (np.arange(splits)[:, None] * (splits + 1) + np.arange(splits)).ravel()
    right, below = corner + 1, corner + splits + 1
    return ObjectModel.from_mesh("tile", vertices, np.concatenate([
        np.stack([corner, right, below], -1), np.stack([right, below + 1, below], -1)]))  # fmt: skip


def colored(picture, color):
    """Pixels (height, width) of about this color: lines are drawn with soft edges."""
    return np.abs(picture.astype(int) - color).max(-1) < 60


def at(x=0.0, y=0.0, z=0.5):
    return poses.from_rotation_translation(np.eye(3), [x, y, z])


@pytest.mark.parametrize("splits", [1, 8, 200])
def test_a_silhouette_is_the_projection_however_fine_the_mesh(splits):
    mask = silhouette(model(splits), CAMERA, at())
    v, u = np.nonzero(mask)
    half = 0.05 / 0.5 * 150
    assert abs(np.ptp(u) - 2 * half) <= 2
    assert abs(np.ptp(v) - 2 * half) <= 2
    assert abs((mask > 0).sum() / (2 * half) ** 2 - 1) < 0.08  # no holes
    assert np.abs([u.mean() - CAMERA.cx, v.mean() - CAMERA.cy]).max() < 0.6


def test_outlines_have_the_colors_asked_for_and_leave_the_rest_alone():
    depth = np.full((120, 160), 0.6, np.float32)
    plain = shade(depth, CAMERA)
    picture = draw_poses(depth, CAMERA, model(), np.stack([at(-0.1), at(0.1)]), [GREEN, RED])
    changed = (picture != plain).any(-1)
    assert 100 < changed.sum() < 1000
    for color, left in ((GREEN, True), (RED, False)):
        _, u = np.nonzero(colored(picture, color))
        assert len(u) > 20
        assert ((u < 80) == left).all()


def test_scale_enlarges_the_picture_and_canvas_draws_on():
    depth = np.full((120, 160), 0.6, np.float32)
    first = draw_poses(depth, CAMERA, model(), at()[None], GREEN, scale=3)
    both = draw_poses(depth, CAMERA, model(), at(0.12)[None], BLUE, scale=3, canvas=first)
    assert first.shape == (360, 480, 3)
    assert colored(both, GREEN).any()
    assert colored(both, BLUE).any()
    assert not colored(first, BLUE).any()


@pytest.mark.parametrize(
    "pose",
    [
        at(z=-0.5), at(z=0.0), at(x=50.0), at(z=1e-9), at(z=40.0),
        poses.from_rotation_translation(poses.from_axis_angle([1.0, 0, 0], 1.5), [0, 0, 0.02]),
    ],
)  # fmt: skip
def test_poses_behind_beside_and_through_the_camera_are_survived(pose):
    picture = draw_poses(np.full((120, 160), 0.6, np.float32), CAMERA, model(6), pose[None])
    assert picture.shape == (120, 160, 3)


def test_an_object_that_is_cut_by_the_frame_is_drawn_up_to_it():
    mask = silhouette(model(), CAMERA, at(x=0.26))
    assert mask[:, -1].any()
    assert not mask[:, :100].any()


def test_depth_without_any_return_and_without_poses_is_black():
    assert not draw_poses(np.zeros((120, 160)), CAMERA, model(), np.zeros((0, 4, 4))).any()


def test_missing_depth_is_black_in_the_shaded_picture():
    depth = np.full((120, 160), 0.6, np.float32)
    depth[10:20, 30:50] = 0
    picture = shade(depth, CAMERA)
    assert not picture[10:20, 30:50].any()
    assert picture[60:].all()


def test_a_model_without_mesh_is_drawn_by_its_points():
    bare = replace(model(), vertices=None, faces=None)
    assert 0.8 < (silhouette(bare, CAMERA, at()) > 0).sum() / (silhouette(model(), CAMERA, at()) > 0).sum() <= 1.02
    with pytest.raises(InputError, match="neither"):
        silhouette(replace(bare, points=None), CAMERA, at())


def test_a_depth_image_of_another_size_is_refused():
    with pytest.raises(InputError, match="160x120"):
        shade(np.zeros((10, 20)), CAMERA)
