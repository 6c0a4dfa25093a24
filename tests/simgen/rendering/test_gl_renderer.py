"""OpenGL draws what our rasterizer draws. Skipped, with the reason, where there is no OpenGL."""

from __future__ import annotations

import gc
import importlib.util
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.config_sections import BinSize
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.physics.bin_shape import bin_mesh
from simgen.rendering import gl_platform
from simgen.rendering.gl_platform import SETTLED, VARIABLE, require_gl
from simgen.rendering.rasterizer import Rasterizer

CAMERA = Camera(160, 120, 150.0, 140.0, 77.3, 61.8)
BUNNY = BUILTIN_OBJECTS["bunny"].make()
BACKGROUND = bin_mesh(BinSize(0.5, 0.5, 0.1))
FROM_ABOVE = poses.from_rotation_translation(
    poses.from_axis_angle([1.0, 0, 0], np.pi - 0.4) @ poses.from_axis_angle([0, 0, 1.0], 0.6), [0.02, 0.01, 0.6]
)


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """The platform that works here, kept for all tests of this file."""
    try:
        require_gl()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def both() -> tuple:
    from simgen.rendering.gl_renderer import GlRenderer

    return GlRenderer(CAMERA, *BUNNY, BACKGROUND), Rasterizer(CAMERA, *BUNNY, BACKGROUND)


def pile(seed: int, count: int = 12) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    places = rng.uniform([-0.2, -0.2, 0.05], [0.2, 0.2, 0.15], (count, 3))
    return FROM_ABOVE @ poses.from_rotation_translation(poses.random_rotations(rng, count), places)


def shift(depth: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.float64]:
    """Pixels (2,), along u and v, by which `depth` must have moved, where the surface is smooth."""
    slope_v, slope_u = np.gradient(reference.astype(float))
    smooth = (np.abs(slope_u) < 0.01) & (np.abs(slope_v) < 0.01) & (np.abs(depth - reference) < 0.01)
    slopes = np.stack([slope_u[smooth], slope_v[smooth]], -1)
    return np.linalg.lstsq(slopes, (depth - reference)[smooth], rcond=None)[0]


@pytest.mark.parametrize("seed", range(3))
def test_depth_is_that_of_our_rasterizer_without_a_shift(both: tuple, seed: int) -> None:
    gl, cpu = (renderer.render(pile(seed), FROM_ABOVE) for renderer in both)
    same = gl.instance_id == cpu.instance_id
    assert same.mean() > 0.999
    error = np.abs(gl.depth - cpu.depth)[same]
    assert np.median(error) <= 1e-5 and np.quantile(error, 0.999) <= 1e-4
    assert np.abs(shift(gl.depth, cpu.depth)).max() < 0.01


def test_pyrender_left_alone_shifts_the_depth_and_the_test_above_would_see_it(monkeypatch: pytest.MonkeyPatch) -> None:
    from simgen.rendering import gl_renderer

    monkeypatch.setattr(gl_renderer, "_take_one_sample", lambda *_: None)
    other = Camera(164, 120, 150.0, 140.0, 77.3, 61.8)  # of another size, for contexts are kept
    four, ours = (kind(other, *BUNNY, BACKGROUND) for kind in (gl_renderer.GlRenderer, Rasterizer))
    moved = shift(four.render(pile(0), FROM_ABOVE).depth, ours.render(pile(0), FROM_ABOVE).depth)
    assert np.abs(moved).max() > 0.1


def test_renderers_do_not_outlast_or_end_each_other(both: tuple) -> None:
    from simgen.rendering.gl_renderer import GlRenderer

    for camera in (CAMERA, Camera(80, 60, 75.0, 70.0, 38.4, 30.6)):
        GlRenderer(camera, *BUNNY, BACKGROUND).render(pile(0), FROM_ABOVE)
    gc.collect()
    assert both[0].render(pile(0), FROM_ABOVE).pixels_full.min() > 0


@pytest.mark.parametrize("seed", range(2))
def test_whole_silhouettes_are_counted_beyond_the_frame(both: tuple, seed: int) -> None:
    beside = pile(seed)
    beside[:, 0, 3] += 0.25
    beside[6:, 1, 3] -= 0.3
    gl, cpu = (renderer.render(beside, FROM_ABOVE) for renderer in both)
    assert (cpu.box_full[:, 2] > CAMERA.width).any() and (cpu.box_full[:, 0] >= CAMERA.width).any()
    assert np.abs(gl.box_full - cpu.box_full).max() <= 1
    assert gl.pixels_full == pytest.approx(cpu.pixels_full, rel=0.01)


@pytest.mark.parametrize("z", [-0.3, 0.0, 0.06, 0.12])
def test_instances_about_the_camera_are_cut_as_ours_are(both: tuple, z: float) -> None:
    turn = poses.from_axis_angle([1.0, 2.0, 3.0], 1.0)
    near = poses.from_rotation_translation(turn, [0.01, 0.02, z])[None]
    gl, cpu = (renderer.render(near, FROM_ABOVE) for renderer in both)
    assert (gl.instance_id == cpu.instance_id).mean() > 0.99
    assert gl.pixels_full == pytest.approx(cpu.pixels_full, rel=0.02, abs=5)
    same = gl.instance_id == cpu.instance_id
    assert np.median(np.abs(gl.depth - cpu.depth)[same]) < 1e-4


def test_another_background_replaces_the_first(both: tuple) -> None:
    lower = BACKGROUND[0] - [0, 0, 0.1]
    nobody = np.zeros((0, 4, 4))
    for renderer in both:
        renderer.set_background(lower, BACKGROUND[1])
    gl, cpu = (renderer.render(nobody, FROM_ABOVE) for renderer in both)
    for renderer in both:
        renderer.set_background(*BACKGROUND)
    assert np.median(np.abs(gl.depth - cpu.depth)) < 1e-5
    assert gl.depth[60, 80] > both[0].render(nobody, FROM_ABOVE).depth[60, 80] + 0.05


def test_a_build_has_the_same_poses_and_labels(
    debug_shards: Path, run_command: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    done = run_command(
        "simgen", "build", "--object", "bunny", "--preset", "debug", "--scenes", 2, "--bin", "0.3x0.3x0.1",
        "--renderer", "pyrender", "--workers", 1, "-o", tmp_path / "gl",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    ours, theirs = ShardDataset(debug_shards), ShardDataset(tmp_path / "gl")
    assert theirs.header.config["renderer"] == "pyrender"
    for a, b in zip(ours, theirs, strict=True):
        assert (a.instances.cam_from_obj == b.instances.cam_from_obj).all()
        assert a.instances.visibility_geometric == pytest.approx(b.instances.visibility_geometric, abs=0.02)
        assert (a.instance_id == b.instance_id).mean() > 0.999


def test_what_is_missing_is_told_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (VARIABLE, SETTLED):
        monkeypatch.setenv(name, os.environ[name])
        monkeypatch.delenv(name)
    monkeypatch.setattr(gl_platform, "PROBE", "raise SystemExit(1)")
    with pytest.raises(InputError, match=r"egl or osmesa.*apt-get install libegl1"):
        require_gl()
    assert VARIABLE not in os.environ
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'binpose-simgen\[pyrender\]'"):
        require_gl()


def test_a_platform_that_does_not_work_ends_a_build_before_it_starts(
    run_command: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, "nonsense")
    done = run_command("simgen", "build", "--object", "bunny", "--renderer", "pyrender", "-o", tmp_path / "none")
    assert done.returncode == 2
    assert done.stderr.startswith("Error: --renderer pyrender: no OpenGL") and len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "none").exists()
