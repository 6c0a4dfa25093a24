"""The sections of a dataset's config that several parts of simgen read: bin, pile, physics, viewpoints."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from evalkit.errors import InputError

ENGINES = ("pybullet", "rapier")
PILE_RULES = 4  # raised whenever the same config gives other piles
WALL_LESS_REACH = 4.0  # of the bin's half side: as far as the ground that is drawn is sure to reach


@dataclass(frozen=True)
class BinSize:
    """Inner width (world x), depth (y) and height (z) of the open bin, in meters, and whether its walls are there.

    Without walls, as if somebody had lifted them off the pile, instances may roll away, but no farther than `reach`.
    """

    width: float
    depth: float
    height: float
    walls: bool = True

    def __post_init__(self) -> None:
        if not all(math.isfinite(side) and side > 0 for side in (self.width, self.depth, self.height)):
            raise InputError(f"--bin {self}: each side must be a positive number of meters, as in 0.4x0.3x0.1.")

    def __str__(self) -> str:
        return f"{self.width:g}x{self.depth:g}x{self.height:g}"

    @property
    def reach(self) -> tuple[float, float]:
        """How far along x and y, in meters, an instance's center may come to rest from the middle."""
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
class DistractorConfig:
    """Foreign things among the parts: instances of nothing, without labels, that hide what lies behind them.

    Attributes:
        sources: "builtin", or mesh files.
        sha256: of each file, empty for what is built in.
        share: of all that lies in a scene, on average.
    """

    sources: tuple[str, ...]
    sha256: tuple[str, ...]
    share: float

    def __post_init__(self) -> None:
        if not self.sources or len(self.sources) != len(self.sha256):
            raise InputError("--distractors: give builtin, or mesh files with commas between them.")
        if not 0 < self.share <= 0.9:
            raise InputError(f"--share {self.share:g}: of all things in a scene, above 0 and at most 0.9, as in 0.3.")

    def describe(self) -> str:
        known = (f" ({digest[:8]})" if digest else "" for digest in self.sha256)
        names = ", ".join(source + words for source, words in zip(self.sources, known, strict=True))
        return f"{_percent(self.share)} of all that lies there, of {names}."


@dataclass(frozen=True)
class PhysicsConfig:
    """How instances fall and when they count as at rest. The values are PyBullet's; an engine has its own.

    The world is scaled until the object's diameter is `simulated_diameter`, and time with it, so that a screw and a
    car door fall alike; all meters and seconds here are those of the scaled world.
    """

    engine: str = "pybullet"
    rules: int = PILE_RULES  # by which instances start, come back and rest; other rules, other piles
    simulated_diameter: float = 0.1
    gravity: float = 9.81
    fall_time_step: float = 1 / 240  # until the last instance has landed
    thin_fall_time_step: float = 1 / 480  # of thin ones, which longer steps drive into the floor
    fall_iterations: int = 20
    time_step: float = 1 / 120  # afterwards
    thin_time_step: float = 1 / 120  # of very thin ones
    solver_iterations: int = 80  # fewer cost more: piles jitter longer before they rest
    contact_margin: float = 1e-5  # Bullet's default floats hulls 1 mm above each other
    contact_frequency: float = 0.0  # hertz, of the spring that pushes bodies apart; 0 is the engine's own
    contact_damping_ratio: float = 0.0
    friction: float = 0.3  # with 0.5 piles take longer to rest and creep twice as far afterwards
    rolling_friction: float = 1e-3  # or round things roll for ever
    linear_damping: float = 0.5  # share of the speed lost in a second
    angular_damping: float = 0.9
    quiet_window: float = 0.3  # seconds without motion; two quick looks miss 5 mm of late sliding
    quiet_motion: float = 2.5e-4  # meters, of any instance's center or ends of axes
    max_seconds: float = 4.0  # after the last landing; what moves yet is dropped again
    max_attempts: int = 10

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise InputError(f"--physics {self.engine}: use one of {', '.join(ENGINES)}.")
        if self.rules != PILE_RULES:
            raise InputError(
                f"its piles were made by rules {self.rules}, this version of simgen has rules {PILE_RULES}; install "
                "the version that made them, or build them anew."
            )


@dataclass(frozen=True)
class ViewpointConfig:
    """Where cameras stand: everything is drawn uniformly within its bounds, the tilt over the cap's area.

    Attributes:
        min_tilt_degrees, max_tilt_degrees: between the optical axis and the vertical.
        nearest, farthest: multiples of the distance from which the bin's opening just fits the image's narrower side.
        look_at_jitter: the middle of the image looks at a point of the floor that is up to this share of the bin's
            width and depth from its middle.
        max_turn_degrees: about the optical axis, to either side of where image rows run along the bin's width; where
            the table was measured, of the bin on it.
        cam_from_table: rows of the measured pose (4, 4) of the bin's floor, z up; None where tilt and distance say it.
    """

    min_tilt_degrees: float = 0.0
    max_tilt_degrees: float = 35.0
    nearest: float = 1.0
    farthest: float = 1.5
    look_at_jitter: float = 0.0
    max_turn_degrees: float = 180.0
    cam_from_table: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        _require_within("--tilt", self.max_tilt_degrees, 0.0, 80.0)
        _require_within("--tilt", self.min_tilt_degrees, 0.0, self.max_tilt_degrees)
        _require_within("--distance", self.farthest, 0.01, 100.0)
        _require_within("--distance", self.nearest, 0.01, self.farthest)
        _require_within("--look-at-jitter", self.look_at_jitter, 0.0, 0.5)
        _require_within("max_turn_degrees", self.max_turn_degrees, 0.0, 180.0)
        if self.cam_from_table is not None and [len(row) for row in self.cam_from_table] != [4, 4, 4, 4]:
            raise InputError("cam_from_table: a pose has four rows of four numbers.")

    def describe(self) -> str:
        if self.cam_from_table is not None:
            tilt = math.degrees(math.acos(min(max(-self.cam_from_table[2][2], -1.0), 1.0)))
            return (
                f"tilted by {tilt:.3g}° as the table was measured, the bin's middle {self.cam_from_table[2][3]:.4g} m "
                f"along the optical axis, the bin turned by up to {self.max_turn_degrees:g}° and up to "
                f"{_percent(self.look_at_jitter)} of its sides aside."
            )
        return (
            f"tilted by {self.min_tilt_degrees:g} to {self.max_tilt_degrees:g}° where walls hide no more than half "
            f"the floor, turned by up to {self.max_turn_degrees:g}°, from {self.nearest:g} to {self.farthest:g} times "
            f"the distance at which the bin fits, looking up to {_percent(self.look_at_jitter)} of its sides off the "
            f"middle."
        )


def _percent(share: float) -> str:
    return f"{100 * share:g}%"


def _require_within(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise InputError(f"{name} {value:g}: must be {least:g} to {most:g}.")
