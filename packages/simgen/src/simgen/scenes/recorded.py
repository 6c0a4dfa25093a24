"""Scenes whose poses are known beforehand: simulated earlier, elsewhere, or published by somebody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RecordedScenes:
    """Poses of consecutive scenes, and what a dataset's header says of their origin.

    Attributes:
        first: number of the first scene.
        world_from_obj: (n_s, 4, 4) of each scene, meters.
        attempts: drops that each scene took.
        origin: entries of the header's config beside those of :class:`simgen.config.BuildConfig`.
        software: versions of the physics that made the poses.
        cam_from_world: (views, 4, 4) of each scene; None where the config's viewpoints are drawn.
    """

    first: int
    world_from_obj: Sequence[Array]
    attempts: Sequence[int]
    origin: dict[str, Any]
    software: dict[str, str]
    cam_from_world: Sequence[Array] | None = None

    def scene(self, index: int) -> tuple[Array, int, Array | None]:
        """Scene number `index`: its world_from_obj, the drops that it took, and its cameras where they are recorded."""
        row = index - self.first
        cameras = None if self.cam_from_world is None else self.cam_from_world[row]
        return self.world_from_obj[row], self.attempts[row], cameras

    def only(self, numbers: range) -> RecordedScenes:
        """Those of the scenes `numbers`, which is as little as a worker needs to be sent."""
        part = slice(numbers.start - self.first, numbers.stop - self.first)
        cameras = None if self.cam_from_world is None else self.cam_from_world[part]
        return replace(
            self,
            first=numbers.start,
            world_from_obj=self.world_from_obj[part],
            attempts=self.attempts[part],
            cam_from_world=cameras,
        )
