"""What is built: frozen dataclasses whose JSON form travels in every shard, and the presets as plain functions.

Whatever changes a byte of the shards is here; what does not (workers, folder) is not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from evalkit.camera import Camera
from evalkit.errors import InputError
from evalkit.shards import COMPRESSIONS

FOCAL_PER_WIDTH = 0.9  # 58 degrees across, as the depth cameras of the paper's time have
MAX_COUNT = 10_000_000
MAX_INSTANCES = 65_534  # ids are uint16, 0 is nobody


@dataclass(frozen=True)
class BinSize:
    """Inner width (world x), depth (y) and height (z) of the open bin, in metres."""

    width: float
    depth: float
    height: float

    def __post_init__(self) -> None:
        if not all(math.isfinite(side) and side > 0 for side in (self.width, self.depth, self.height)):
            raise InputError(f"--bin {self}: each side must be a positive number of metres, as in 0.4x0.3x0.1.")

    def __str__(self) -> str:
        return f"{self.width:g}x{self.depth:g}x{self.height:g}"


@dataclass(frozen=True)
class PhysicsConfig:
    """How instances fall and when they count as at rest.

    The world is scaled until the object's diameter is `simulated_diameter`, and time with it, so that a screw and a
    car door fall alike; all metres and seconds here are those of the scaled world.
    """

    simulated_diameter: float = 0.1
    gravity: float = 9.81
    fall_time_step: float = 1 / 480  # until the last instance has landed; with 1 / 240 plates are driven into the floor
    fall_iterations: int = 20
    time_step: float = 1 / 120  # afterwards
    solver_iterations: int = 80  # fewer cost more: piles jitter longer before they rest
    collision_margin: float = 1e-5  # Bullet's default floats hulls 1 mm above each other
    friction: float = 0.3  # with 0.5 piles take longer to rest and creep twice as far afterwards
    rolling_friction: float = 1e-3  # or round things roll for ever
    linear_damping: float = 0.5  # share of the speed lost in a second
    angular_damping: float = 0.9
    quiet_window: float = 0.5  # seconds without motion; two quick looks miss 5 mm of late sliding
    quiet_motion: float = 4e-4  # metres, of any instance's centre or ends of axes
    max_seconds: float = 8.0
    max_attempts: int = 50


@dataclass(frozen=True)
class ViewpointConfig:
    """The cap of camera positions above the bin.

    Distances are multiples of the one from which the bin's opening just fits the image's narrower side.
    """

    max_tilt_degrees: float = 35.0
    nearest: float = 1.0
    farthest: float = 1.5


@dataclass(frozen=True)
class BuildConfig:
    """One dataset. `bin` None chooses it from the object's size and the largest number of instances."""

    scenes: int
    views: int
    instances_min: int
    instances_max: int
    camera: Camera
    seed: int = 0
    bin: BinSize | None = None
    compression: str = "zstd"
    shard_scenes: int = 10
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    viewpoints: ViewpointConfig = field(default_factory=ViewpointConfig)

    def __post_init__(self) -> None:
        for option, value in (
            ("--scenes", self.scenes),
            ("--views", self.views),
            ("--shard-scenes", self.shard_scenes),
        ):
            if not 1 <= value <= MAX_COUNT:
                raise InputError(f"{option} {value}: must be 1 to {MAX_COUNT}.")
        if not 1 <= self.instances_min <= self.instances_max <= MAX_INSTANCES:
            raise InputError(
                f"--instances {self.instances_min}-{self.instances_max}: give MIN-MAX with "
                f"1 <= MIN <= MAX <= {MAX_INSTANCES}, as in 10-20."
            )
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: must be 0 or more.")
        if self.compression not in COMPRESSIONS:
            raise InputError(f"--compression {self.compression}: use one of {', '.join(COMPRESSIONS)}.")

    @property
    def shards(self) -> int:
        """Number of shards, the last of which may hold fewer scenes."""
        return -(-self.scenes // self.shard_scenes)

    def scenes_of_shard(self, shard: int) -> range:
        return range(shard * self.shard_scenes, min((shard + 1) * self.shard_scenes, self.scenes))

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def default() -> BuildConfig:
    """The paper's: 2,000 scenes of 10 to 20 instances, 17 views each, 640 x 480."""
    return BuildConfig(2000, 17, 10, 20, default_camera(640, 480))


def demo() -> BuildConfig:
    """Enough to train the small network on two CPU cores in minutes."""
    return BuildConfig(640, 16, 10, 20, default_camera(320, 240))


def debug() -> BuildConfig:
    """Seconds, for tests."""
    return BuildConfig(4, 3, 3, 5, default_camera(160, 120), shard_scenes=2)


PRESETS: dict[str, Callable[[], BuildConfig]] = {"default": default, "demo": demo, "debug": debug}


def default_camera(width: int, height: int) -> Camera:
    """A pinhole camera of that many pixels, its principal point in the middle of the image."""
    focal = FOCAL_PER_WIDTH * width
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def parse_instances(text: str) -> tuple[int, int]:
    """``10-20`` or ``15`` to (smallest, largest) number of instances a scene.

    Raises:
        InputError: it is neither.
    """
    match = re.fullmatch(r"\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?", text)
    if match is None:
        raise InputError(f"--instances {text}: give a number or a range MIN-MAX, as in 10-20.")
    return int(match[1]), int(match[2] or match[1])


def parse_bin(text: str) -> BinSize | None:
    """``auto`` (None) or ``WxDxH`` in metres.

    Raises:
        InputError: it is neither.
    """
    if text == "auto":
        return None
    try:
        width, depth, height = (float(side) for side in text.lower().split("x"))
    except ValueError:
        raise InputError(f"--bin {text}: give auto or the inner WxDxH in metres, as in 0.4x0.3x0.1.") from None
    return BinSize(width, depth, height)
