"""A dataset to be made: all that its bytes depend on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.shard_format import ShardHeader
from evalkit.objects.model import ObjectModel
from simgen.config import BuildConfig
from simgen.config_sections import BinSize
from simgen.physics.bin_size import scene_bin
from simgen.scenes.identity import fingerprint, identity_of
from simgen.scenes.recorded import RecordedScenes
from simgen.scenes.software import physics_software, rendering_software

if TYPE_CHECKING:
    from simgen.objects.foreign_things import Thing

Part = tuple[NDArray[np.float64], NDArray[np.int32]]


@dataclass(frozen=True, eq=False)
class Job:
    """All that the bytes of a dataset depend on. Make it with :func:`simgen.scenes.plan.plan`.

    Header and identity are computed at their first use, and travel with the job to its workers.

    Attributes:
        config: complete, its bin chosen.
        model: with its mesh.
        convex_parts: what falls, (vertices (V, 3), faces (F, 3)) each, unless the scenes are recorded.
        depth_unit: meters a step of the stored depth.
        recorded: the scenes whose poses are known beforehand; None where they are simulated.
    """

    config: BuildConfig
    model: ObjectModel
    convex_parts: list[Part]
    depth_unit: float
    recorded: RecordedScenes | None = None

    def __post_init__(self) -> None:
        if self.config.bin is None:
            raise ValueError("a job's config names its bin")

    @property
    def bin(self) -> BinSize:
        """The dataset's bin; that of a scene may differ from it."""
        assert self.config.bin is not None
        return self.config.bin

    def scene_bin(self, scene: int) -> BinSize:
        """The bin of scene number `scene`."""
        return scene_bin(self.config.pile, self.bin, self.config.seed, scene)

    @cached_property
    def header(self) -> ShardHeader:
        """What all shards of the dataset share; of recorded scenes, as if they had been simulated here."""
        if self.recorded is None:
            origin = {"geometry_sha256": fingerprint([self.model.mesh, *self.convex_parts])}
            physics = physics_software(self.config.physics.engine)
        else:
            origin, physics = self.recorded.origin, self.recorded.software
        config, software = self.config.to_json() | origin, rendering_software() | physics
        return ShardHeader(self.config.camera, self.depth_unit, self.model, config, self.config.seed, software)

    @cached_property
    def foreign_things(self) -> list[Thing]:
        """What the config's distractors are drawn from.

        Raises:
            InputError: a file of theirs is missing, or not what it was.
        """
        from simgen.objects.foreign_things import things_of  # only here: it brings trimesh

        found = self.config.distractors
        return (
            []
            if found is None
            else things_of(found, str(self.model.notes.get("source", self.model.name)), self.model.diameter)
        )

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What all files of the dataset have in common."""
        return identity_of(self.header)

    def for_shard(self, shard: int) -> Job:
        """As much of the job as the shard needs."""
        if self.recorded is None:
            return self
        return replace(self, recorded=self.recorded.only(self.config.scenes_of_shard(shard)))
