"""The presets: plain functions that return a config."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from evalkit.geometry.camera import Camera
from simgen.config import BuildConfig
from simgen.config_sections import DistractorConfig, PhysicsConfig, PileConfig, ViewpointConfig

FOCAL_PER_WIDTH = 0.9  # 58 degrees across, as the depth cameras of the paper's time have


def default() -> BuildConfig:
    """Half as many scenes as the paper's: as many images as `posenet fit` sees in its 45 minutes on one core."""
    return replace(paper(), scenes=1000)


def paper() -> BuildConfig:
    """Sock et al. 2018: 2,000 scenes of 10 to 20 instances, 17 views each, 640 x 480."""
    return BuildConfig(2000, 17, 10, 20, default_camera(640, 480))


def demo() -> BuildConfig:
    """Enough to train the small network on two CPU cores in minutes."""
    return BuildConfig(640, 16, 10, 20, default_camera(320, 240))


def debug() -> BuildConfig:
    """Seconds, for tests."""
    return BuildConfig(4, 3, 3, 5, default_camera(160, 120), shard_scenes=2)


def sileane() -> BuildConfig:
    """Deep heaps from above, as the Siléane dataset's synthetic scenes show them: cut by the frame, mostly hidden.

    Bin, depth of the heap and distance in relation to the object, and the camera, are those of its bunny_3 scenes.
    """
    return BuildConfig(
        500,
        4,
        20,
        80,
        Camera(506, 474, 1152.31, 1152.31, 139.459, 237.001),
        pile=PileConfig(layers=1.8, aspect=1.25, wall_height=1.5, bin_jitter=0.05, drop_spread_min=0.6),
        viewpoints=ViewpointConfig(max_tilt_degrees=5.0, nearest=0.54, farthest=0.62, look_at_jitter=0.1),
    )


def icvl() -> BuildConfig:
    """A camera in the hand before a box or a bare table, as in the ICVL Bin-Picking dataset: tilted, near and far."""
    return BuildConfig(
        1000,
        8,
        10,
        30,
        Camera(640, 480, 550.0, 540.0, 316.0, 244.0),
        pile=PileConfig(layers=2.0, bin_jitter=0.2, wall_probability=0.7, drop_height_max=0.5, drop_spread_min=0.6),
        viewpoints=ViewpointConfig(
            min_tilt_degrees=10.0, max_tilt_degrees=60.0, nearest=0.6, farthest=1.5, look_at_jitter=0.15
        ),
    )


def domestic() -> BuildConfig:
    """A table with several instances among other things, mildly hidden: the paper's domestic cup (its Table 3)."""
    return BuildConfig(
        800,
        8,
        3,
        8,
        default_camera(640, 480),
        pile=PileConfig(layers=0.35, bin_jitter=0.2, wall_probability=0.0, drop_spread_min=0.8),
        viewpoints=ViewpointConfig(
            min_tilt_degrees=20.0, max_tilt_degrees=55.0, nearest=0.8, farthest=1.4, look_at_jitter=0.1
        ),
        distractors=DistractorConfig(("builtin",), ("",), 0.5),
    )


PRESETS: dict[str, Callable[[], BuildConfig]] = {
    "default": default,
    "paper": paper,
    "sileane": sileane,
    "icvl": icvl,
    "domestic": domestic,
    "demo": demo,
    "debug": debug,
}


def rapier() -> PhysicsConfig:
    """Rapier: objects of unit size, for at 0.1 m they creep; and gravity with them, so that seconds stay the same."""
    return PhysicsConfig(
        engine="rapier",
        simulated_diameter=1.0,
        gravity=98.1,
        fall_time_step=1 / 120,
        thin_fall_time_step=1 / 480,
        fall_iterations=8,
        time_step=1 / 60,
        thin_time_step=1 / 240,  # or rods slide through each other, and never rest
        solver_iterations=16,
        contact_margin=1e-3,
        contact_frequency=100.0,
        contact_damping_ratio=5.0,
        rolling_friction=0.0,
        quiet_window=0.5,
        quiet_motion=4e-3,
    )


PHYSICS: dict[str, Callable[[], PhysicsConfig]] = {"pybullet": PhysicsConfig, "rapier": rapier}


def default_camera(width: int, height: int) -> Camera:
    """A pinhole camera of that many pixels, its principal point in the middle of the image."""
    focal = FOCAL_PER_WIDTH * width
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
