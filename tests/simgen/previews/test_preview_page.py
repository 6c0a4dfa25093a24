"""The preview as a page: it holds everything, asks for nothing, and shows the scene in a browser."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from simgen.config import BuildConfig
from simgen.config_sections import BinSize, PileConfig
from simgen.physics.bin_size import recorded_bin, scene_bin
from simgen.presets import default_camera
from simgen.previews.preview_page import preview_page
from simgen.previews.scene_viewer import MAX_FACES, drawn_mesh, measured_points, scene_document, viewer_script
from simgen.previews.sheet import instance_colors, spread_frames


@pytest.fixture(scope="module")
def dataset(debug_shards: Path) -> ShardDataset:
    return ShardDataset(debug_shards)


@pytest.fixture(scope="module")
def page(dataset: ShardDataset) -> str:
    return preview_page(dataset, spread_frames(dataset, 2))


def floats(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(shape)


def test_the_page_refers_to_nothing_outside_itself(page: str) -> None:
    assert not re.findall(r"(?:src|href)\s*=\s*[\"'](?!data:|#)", page)
    assert "url(" not in page and "@import" not in page
    assert not re.findall(r"\b(?:fetch|XMLHttpRequest|import)\s*\(", page)


def test_only_the_viewer_may_run(page: str) -> None:
    digest = base64.b64encode(hashlib.sha256(viewer_script().encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    assert f"<script>{viewer_script()}</script>" in page


def test_config_and_histograms_are_on_the_page(page: str, dataset: ShardDataset) -> None:
    for name in ("visibility", "instances", "depth", "tilt", "directions"):
        assert f'<figure id="{name}">' in page
    iterations = dataset.header.config["physics"]["solver_iterations"]
    assert f"<dt>physics.solver iterations</dt><dd><code>{iterations}</code></dd>" in page
    assert dataset.header.config["geometry_sha256"] in page


def test_a_hostile_name_stays_a_name(dataset: ShardDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    nasty = "</script><script>alert(1)</script>"
    header = replace(
        dataset.header, object=replace(dataset.header.object, name=nasty), config={"<b>": nasty, "bin": {nasty: nasty}}
    )
    monkeypatch.setattr(dataset, "header", header)
    page = preview_page(dataset, [0])
    assert "alert(1)</script>" not in page and "<b>" not in page
    assert page.count("<script") == 2


def test_measured_points_lie_on_the_ground_the_walls_or_an_instance(dataset: ShardDataset) -> None:
    points, numbers = measured_points(dataset[0:3])
    size = dataset.header.config["bin"]
    ground = points[(numbers == 0) & (np.abs(points[:, :2]).max(1) > size["width"])]
    assert len(ground) > 100
    assert np.abs(ground[:, 2]).max() < 1e-3
    first = dataset[0].instances
    world_from_obj = np.linalg.inv(dataset[0].cam_from_world) @ first.cam_from_obj
    centers = dataset.header.object.centers(world_from_obj)
    for number in np.unique(numbers[numbers > 0]):
        away = np.linalg.norm(points[numbers == number] - centers[number - 1], axis=1)
        assert away.max() < dataset.header.object.diameter / 2 + 1e-3


def test_instances_have_the_colors_of_the_contact_sheet(dataset: ShardDataset) -> None:
    views = dataset[0:1]
    document = scene_document(views, dataset.header.object)
    count = len(views[0].instances)
    assert floats(document["colors"], count, 3) == pytest.approx(instance_colors(count), abs=1e-6)
    assert floats(document["world_from_mesh"], count, 4, 4)[:, 3].tolist() == [[0, 0, 0, 1]] * count


def test_the_files_origin_changes_nothing_of_what_the_viewer_draws(dataset: ShardDataset) -> None:
    view, model = dataset[0], dataset.header.object
    assert model.vertices is not None and model.faces is not None
    offset = np.array([3.0, -1.0, 2.0])
    moved = ObjectModel.from_mesh(model.name, model.vertices + offset, model.faces)
    poses_moved = view.instances.cam_from_obj @ poses.from_rotation_translation(np.eye(3), -offset)
    elsewhere = replace(view, instances=replace(view.instances, cam_from_obj=poses_moved))
    near, far = scene_document([view], model), scene_document([elsewhere], moved)
    for name, shape in (("vertices", (-1, 3)), ("world_from_mesh", (-1, 4, 4))):
        assert floats(far[name], *shape) == pytest.approx(floats(near[name], *shape), abs=1e-6)
    assert far["faces"] == near["faces"]


def test_the_bin_is_drawn_as_it_is_in_that_scene() -> None:
    config = BuildConfig(
        9, 1, 1, 1, default_camera(64, 48), bin=BinSize(0.3, 0.2, 0.1), pile=PileConfig(bin_jitter=0.2), seed=3
    )
    sizes = {recorded_bin(config.to_json(), scene) for scene in range(9)}
    assert len(sizes) == 9
    assert recorded_bin(config.to_json(), 4) == scene_bin(config.pile, config.bin, 3, 4)
    assert recorded_bin({}, 0) is None and recorded_bin({"bin": None, "pile": {}, "seed": 0}, 0) is None


def test_a_fine_mesh_is_thinned_and_keeps_its_shape() -> None:
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    height = np.linspace(0, 0.1, 100)
    vertices = np.stack([*(0.05 * f(np.tile(angle, 100)) for f in (np.cos, np.sin)), np.repeat(height, 200)], -1)
    a = (np.arange(99)[:, None] * 200 + np.arange(200)).reshape(-1)
    b = (np.arange(99)[:, None] * 200 + (np.arange(200) + 1) % 200).reshape(-1)
    faces = np.concatenate([np.stack([a, b, b + 200], -1), np.stack([a, b + 200, a + 200], -1)])
    thin, left = drawn_mesh(ObjectModel.from_mesh("tube", vertices, faces))
    assert 0 < len(left) <= 1.05 * MAX_FACES < len(faces)
    assert np.linalg.norm(thin[:, :2], axis=1) == pytest.approx(np.full(len(thin), 0.05), abs=2e-3)
    assert drawn_mesh(replace(ObjectModel.from_mesh("tube", vertices, faces), vertices=None))[0].shape == (0, 3)


def test_a_browser_draws_the_scene_as_its_first_camera_sees_it(
    page: str, dataset: ShardDataset, chromium: Callable[..., str], tmp_path: Path
) -> None:
    chosen = page.replace("<option value=0>", "<option value=0 selected>").replace(
        ".viewer canvas {", ".viewer canvas { position: fixed; left: 0; top: 0; z-index: 9; border: 0;"
    )
    for name in ("points", "bin"):
        chosen = chosen.replace(f'data-show="{name}" checked', f'data-show="{name}"')
    (tmp_path / "page.html").write_text(chosen, encoding="utf-8")
    address = (tmp_path / "page.html").as_uri()
    camera, frame = dataset.header.camera, dataset[spread_frames(dataset, 2)[0]]
    view = dataset[int(np.flatnonzero(dataset.scene_index == frame.scene_index)[0])]
    chromium("--window-size=800,600", f"--screenshot={tmp_path / 'page.png'}", address)
    shown = cv2.imread(str(tmp_path / "page.png"))
    canvas = shown[: round(0.75 * shown.shape[0])]  # its height is 75vh
    scale = min(canvas.shape[0] / camera.height, canvas.shape[1] / camera.width)
    v, u = np.indices((camera.height, camera.width))
    x = (u + 0.5 - camera.width / 2) * scale + canvas.shape[1] / 2
    y = (v + 0.5 - camera.height / 2) * scale + canvas.shape[0] / 2
    pixels = canvas[y.astype(int), x.astype(int)].astype(float)
    drawn = pixels.max(-1) > 50
    assert (drawn == (view.instance_id > 0)).mean() > 0.99
    palette = instance_colors(len(view.instances))[:, ::-1]
    hue = pixels / np.linalg.norm(pixels, axis=-1, keepdims=True).clip(1)
    nearest = (hue[..., None, :] * (palette / np.linalg.norm(palette, axis=-1, keepdims=True))).sum(-1).argmax(-1) + 1
    both = drawn & (view.instance_id > 0)
    assert (nearest == view.instance_id)[both].mean() > 0.97
