"""What is built: frozen dataclasses whose JSON form travels in every shard, and the presets as plain functions.

Whatever changes a byte of the shards is here; what does not (workers, folder) is not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from evalkit.datasets.shard_format import COMPRESSIONS
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from simgen.sensors.config import SensorConfig

FOCAL_PER_WIDTH = 0.9  # 58 degrees across, as the depth cameras of the paper's time have
RENDERERS = ("cpu", "pyrender")
MAX_COUNT = 10_000_000
MAX_INSTANCES = 65_534  # ids are uint16, 0 is nobody
WALL_LESS_REACH = 4.0  # of the bin's half side: as far as the ground that is drawn is sure to reach


@dataclass(frozen=True)
class BinSize:
    """Inner width (world x), depth (y) and height (z) of the open bin, in metres, and whether its walls are there.

    Without walls, as if somebody had lifted them off the pile, instances may roll away, but no farther than `reach`.
    """

    width: float
    depth: float
    height: float
    walls: bool = True

    def __post_init__(self) -> None:
        if not all(math.isfinite(side) and side > 0 for side in (self.width, self.depth, self.height)):
            raise InputError(f"--bin {self}: each side must be a positive number of metres, as in 0.4x0.3x0.1.")

    def __str__(self) -> str:
        return f"{self.width:g}x{self.depth:g}x{self.height:g}"

    @property
    def reach(self) -> tuple[float, float]:
        """How far along x and y, in metres, an instance's centre may come to rest from the middle."""
        share = 0.5 if self.walls else 0.5 * WALL_LESS_REACH
        return share * self.width, share * self.depth

    def times(self, factor: float) -> BinSize:
        """The same bin with all its sides that many times as long."""
        return replace(self, width=self.width * factor, depth=self.depth * factor, height=self.height * factor)


@dataclass(frozen=True)
class PileConfig:
    """The bin where it is automatic, and what differs from scene to scene about it and about the drop.

    Attributes:
        layers: shadows of all instances, of the largest number, over the floor's area.
        aspect: width over depth of the automatic bin.
        wall_height: of the automatic bin, in object diameters.
        bin_jitter: width and depth of a scene's bin differ from the dataset's by up to this share, each by itself.
        wall_probability: share of the scenes whose bin has walls; in the others they are lifted off the pile.
        drop_height_max: instances start up to this many object diameters higher than they need to.
        drop_spread_min: instances start over the middle of the bin, this share of its sides at least.
    """

    layers: float = 1.5  # visibility then spreads from 0 to 1, 0.67 on average
    aspect: float = 1.0
    wall_height: float = 1.0
    bin_jitter: float = 0.0
    wall_probability: float = 1.0
    drop_height_max: float = 0.0
    drop_spread_min: float = 1.0

    def __post_init__(self) -> None:
        for name, value, least, most in (
            ("layers", self.layers, 0.01, 100.0),
            ("aspect", self.aspect, 0.1, 10.0),
            ("wall_height", self.wall_height, 0.01, 100.0),
            ("--bin-jitter", self.bin_jitter, 0.0, 0.5),
            ("--walls", self.wall_probability, 0.0, 1.0),
            ("drop_height_max", self.drop_height_max, 0.0, 10.0),
            ("drop_spread_min", self.drop_spread_min, 0.1, 1.0),
        ):
            _require_within(name, value, least, most)

    def describe(self) -> str:
        return (
            f"{self.layers:g} layers high in an automatic bin of aspect {self.aspect:g} with walls of "
            f"{self.wall_height:g} diameters; bin sides ± {_percent(self.bin_jitter)}, walls in "
            f"{_percent(self.wall_probability)} of the scenes, dropped over {_percent(self.drop_spread_min)} to 100% "
            f"of its sides from up to {self.drop_height_max:g} diameters higher than needed."
        )


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
    """Where cameras stand: everything is drawn uniformly within its bounds, the tilt over the cap's area.

    Attributes:
        min_tilt_degrees, max_tilt_degrees: between the optical axis and the vertical.
        nearest, farthest: multiples of the distance from which the bin's opening just fits the image's narrower side.
        look_at_jitter: the middle of the image looks at a point of the floor that is up to this share of the bin's
            width and depth from its middle.
        max_turn_degrees: about the optical axis, to either side of where image rows run along the bin's width.
    """

    min_tilt_degrees: float = 0.0
    max_tilt_degrees: float = 35.0
    nearest: float = 1.0
    farthest: float = 1.5
    look_at_jitter: float = 0.0
    max_turn_degrees: float = 180.0

    def __post_init__(self) -> None:
        _require_within("--tilt", self.max_tilt_degrees, 0.0, 80.0)
        _require_within("--tilt", self.min_tilt_degrees, 0.0, self.max_tilt_degrees)
        _require_within("--distance", self.farthest, 0.01, 100.0)
        _require_within("--distance", self.nearest, 0.01, self.farthest)
        _require_within("--look-at-jitter", self.look_at_jitter, 0.0, 0.5)
        _require_within("max_turn_degrees", self.max_turn_degrees, 0.0, 180.0)

    def describe(self) -> str:
        return (
            f"tilted by {self.min_tilt_degrees:g} to {self.max_tilt_degrees:g}° where walls hide no more than half "
            f"the floor, turned by up to {self.max_turn_degrees:g}°, from {self.nearest:g} to {self.farthest:g} times "
            f"the distance at which the bin fits, looking up to {_percent(self.look_at_jitter)} of its sides off the "
            f"middle."
        )


@dataclass(frozen=True)
class BuildConfig:
    """One dataset. `bin` None chooses it from the object's size and the largest number of instances.

    `sensor` None is a perfect one; with another, `keep_ideal` stores the depth without its errors too.
    """

    scenes: int
    views: int
    instances_min: int
    instances_max: int
    camera: Camera
    seed: int = 0
    bin: BinSize | None = None
    compression: str = "zstd"
    shard_scenes: int = 10
    pile: PileConfig = field(default_factory=PileConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    viewpoints: ViewpointConfig = field(default_factory=ViewpointConfig)
    sensor: SensorConfig | None = None
    keep_ideal: bool = False
    renderer: str = "cpu"

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
        if self.renderer not in RENDERERS:
            raise InputError(f"--renderer {self.renderer}: use one of {', '.join(RENDERERS)}.")
        if self.keep_ideal and self.sensor is None:
            raise InputError("--keep-ideal: the depth is ideal already; give a --sensor, as in --sensor stereo.")

    @property
    def shards(self) -> int:
        """Number of shards, the last of which may hold fewer scenes."""
        return -(-self.scenes // self.shard_scenes)

    def scenes_of_shard(self, shard: int) -> range:
        return range(shard * self.shard_scenes, min((shard + 1) * self.shard_scenes, self.scenes))

    def describe(self) -> str:
        """Every value, a line for each part: what is made, what is drawn within which bounds, and the constants."""
        camera, kept = self.camera, ", ideal depth kept too" if self.keep_ideal else ""
        lines = [
            f"Set: {self.scenes} scenes of {self.views} views, seed {self.seed}, {self.shard_scenes} scenes a shard, "
            f"{self.compression}, drawn by the {self.renderer} renderer{kept}.",
            f"Camera: {camera.width} x {camera.height} pixels, fx {camera.fx:.9g}, fy {camera.fy:.9g}, "
            f"cx {camera.cx:.9g}, cy {camera.cy:.9g}.",
            f"Piles: {self.instances_min} to {self.instances_max} instances, {self.pile.describe()}",
            f"Views: {self.viewpoints.describe()}",
            f"Physics: {_listed(self.physics)}.",
        ]
        if self.bin is not None:
            lines.insert(2, f"Bin: {self.bin} m{'' if self.bin.walls else ', without walls'}.")
        return "\n".join(lines if self.sensor is None else [*lines, f"Sensor: {_listed(self.sensor)}."])

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


PRESETS: dict[str, Callable[[], BuildConfig]] = {
    "default": default,
    "sileane": sileane,
    "icvl": icvl,
    "demo": demo,
    "debug": debug,
}


def _listed(values: PhysicsConfig | SensorConfig) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {_number(value)}" for name, value in asdict(values).items())


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _percent(share: float) -> str:
    return f"{100 * share:g}%"


def _require_within(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise InputError(f"{name} {value:g}: must be {least:g} to {most:g}.")


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


def parse_range(option: str, text: str) -> tuple[float, float]:
    """``10-50`` or ``30`` to (smallest, largest).

    Raises:
        InputError: it is neither.
    """
    number = r"(\d{1,9}(?:\.\d{1,9})?)"
    match = re.fullmatch(rf"\s*{number}\s*(?:-\s*{number}\s*)?", text)
    if match is None or float(match[2] or match[1]) < float(match[1]):
        raise InputError(f"{option} {text}: give a number or a range MIN-MAX, as in 0.5-1.5.")
    return float(match[1]), float(match[2] or match[1])


def parse_shards(text: str, count: int) -> range:
    """``0-9`` or ``7`` to the shards of that many that are meant; what is beyond the last is left out.

    Raises:
        InputError: it is neither, or there are none.
    """
    match = re.fullmatch(r"\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?", text)
    shards = range(0) if match is None else range(int(match[1]), min(int(match[2] or match[1]) + 1, count))
    if not shards:
        raise InputError(
            f"--shards {text}: give a number or a range FIRST-LAST of the {count} shards, 0 to {count - 1}."
        )
    return shards


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
