"""The physics engines that piles may be simulated with: what is installed, and a world of one of them."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from evalkit.errors import InputError
from simgen.config_sections import BinSize, PhysicsConfig
from simgen.physics.body import Body
from simgen.physics.distribution import BULLET_DISTRIBUTIONS, bullet_version
from simgen.physics.world import World

RAPIER_DISTRIBUTION = "rapier3d"
ENGINE_DISTRIBUTIONS = (*BULLET_DISTRIBUTIONS, RAPIER_DISTRIBUTION)


def world_of(body: Body, size: BinSize, config: PhysicsConfig) -> World:
    """A new world of the config's engine.

    Raises:
        InputError: the engine is not installed; the sentence says how it is.
    """
    require_engine(config.engine)
    if config.engine == "rapier":
        from simgen.physics.rapier_world import RapierWorld

        return RapierWorld(body, size, config)
    from simgen.physics.bullet_world import BulletWorld

    return BulletWorld(body, size, config)


def require_engine(engine: str) -> None:
    """Raise InputError unless the engine is installed; PyBullet is, with simgen."""
    if engine == "rapier" and find_spec(RAPIER_DISTRIBUTION) is None:
        raise InputError("--physics rapier: Rapier is not installed; run pip install 'binpose-simgen[rapier]'.")


def engine_version(engine: str) -> dict[str, str]:
    """Name and version of the distribution that computes that engine's piles; nothing where there is none."""
    if engine == "pybullet":
        return bullet_version()
    try:
        return {RAPIER_DISTRIBUTION: version(RAPIER_DISTRIBUTION)}
    except PackageNotFoundError:
        return {}
