"""What is built: a frozen dataclass whose JSON form travels in every shard.

Whatever changes a byte of the shards is here; what does not (workers, folder) is not.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from evalkit.datasets.shard_format import COMPRESSIONS
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from simgen.config_sections import BinSize, DistractorConfig, PhysicsConfig, PileConfig, ViewpointConfig
from simgen.sensors.sensor_config import SensorConfig

RENDERERS = ("cpu", "pyrender")
MAX_COUNT = 10_000_000
MAX_INSTANCES = 65_534  # ids are uint16, 0 is nobody


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
    distractors: DistractorConfig | None = None
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
        if self.distractors is not None:
            lines.append(f"Distractors: {self.distractors.describe()}")
        if self.sensor is not None:
            lines.append(f"Sensor: {_listed(self.sensor)}.")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """As it comes back from a file: JSON knows no tuples."""
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return document


def _listed(values: PhysicsConfig | SensorConfig) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {_number(value)}" for name, value in asdict(values).items())


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
