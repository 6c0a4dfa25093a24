"""What both engines owe a heap: it rests, in its bin, whole; what falls out of it comes back."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from simgen.config_sections import BinSize, PhysicsConfig
from simgen.physics.bin_size import fitting_bin
from simgen.physics.body import Body
from simgen.physics.engines import require_engine, world_of
from simgen.physics.pile import Pile, simulate_pile
from simgen.physics.settling import random_quaternions, settle
from simgen.physics.world import World
from simgen.presets import PHYSICS

BALL = [trimesh.creation.icosphere(1, 0.05)]
ANGLE = [trimesh.creation.box([0.08, 0.03, 0.01]), trimesh.creation.box([0.01, 0.03, 0.06])]
TILE = [trimesh.creation.box([0.08, 0.05, 0.004])]
ROD = [trimesh.creation.cylinder(0.00035, 0.1, sections=8)]
SHEET = [trimesh.creation.box([0.08, 0.06, 0.0002])]
RIM = 0.001  # meters; nothing holds a ball in a bin as low


@pytest.fixture(params=list(PHYSICS))
def physics(request: pytest.FixtureRequest) -> PhysicsConfig:
    if request.param == "rapier" and find_spec("rapier3d") is None:
        pytest.skip("Rapier is not installed")
    return PHYSICS[request.param]()


def body_of(meshes: list[trimesh.Trimesh], physics: PhysicsConfig) -> Body:
    return Body.from_parts([(np.asarray(m.vertices), np.asarray(m.faces)) for m in meshes], physics.simulated_diameter)


def pile_of(meshes: list[trimesh.Trimesh], physics: PhysicsConfig, count: int = 8, scene: int = 0) -> Pile:
    size = fitting_bin(vertices_of(meshes), 0.1, count)
    return simulate_pile(body_of(meshes, physics), size, (count, count), physics, 3, scene)


def vertices_of(meshes: list[trimesh.Trimesh]) -> NDArray[np.float64]:
    return np.vstack([mesh.vertices for mesh in meshes])


class Counted:
    """A world that counts what is put back into it."""

    def __init__(self, world: World) -> None:
        self.world, self.put_back = world, 0
        self._put = world.put
        world.put = self  # type: ignore[method-assign,assignment]

    def __call__(self, *where: object) -> None:
        self.put_back += 1
        self._put(*where)  # type: ignore[arg-type]


@pytest.mark.parametrize("meshes", [BALL, ANGLE, TILE], ids=["ball", "angle", "tile"])
def test_a_pile_lies_in_its_bin_on_the_floor_and_stays_there(
    meshes: list[trimesh.Trimesh], physics: PhysicsConfig
) -> None:
    size, pile = fitting_bin(vertices_of(meshes), 0.1, 8), pile_of(meshes, physics)
    points = poses.apply(pile.world_from_obj, vertices_of(meshes))
    assert points[..., 2].min() > -1e-3 and points[..., 2].min(1).min() < 2e-3
    assert (np.abs(points.mean(1)[:, :2]) <= size.reach).all()


@pytest.mark.parametrize("meshes", [BALL, ANGLE, TILE], ids=["ball", "angle", "tile"])
def test_what_has_settled_stays_where_it_is(meshes: list[trimesh.Trimesh], physics: PhysicsConfig) -> None:
    body, rng = body_of(meshes, physics), np.random.default_rng(1)
    with world_of(body, BinSize(0.2, 0.2, 0.2), physics) as world:
        world.drop(np.array([[0.0, 0.0, 0.1 + 0.11 * i] for i in range(6)]) * body.scale, random_quaternions(rng, 6))
        assert settle(world, rng)
        world.hold(np.zeros(6, bool))
        before = poses.apply(world.world_from_obj(), vertices_of(meshes))
        world.rest(physics.quiet_window)
        after = poses.apply(world.world_from_obj(), vertices_of(meshes))
    assert np.abs(after - before).max() < 1e-3


@pytest.mark.parametrize("meshes", [ROD, SHEET], ids=["rod", "sheet"])
def test_what_is_thinner_than_its_fall_in_a_step_stays_above_the_floor(
    meshes: list[trimesh.Trimesh], physics: PhysicsConfig
) -> None:
    """Nor does it weigh too little for the engine's single precision."""
    body, rng = body_of(meshes, physics), np.random.default_rng(2)
    with world_of(body, BinSize(0.2, 0.2, 0.2), physics) as world:
        starts = np.array([[0.05 * (i % 3 - 1), 0.05 * (i // 3), 0.1 + 0.03 * i] for i in range(5)]) * body.scale
        world.drop(starts, random_quaternions(rng, 5))
        world.fall(0.4)
        world.rest(0.4)
        assert (world.lowest() > -0.02 * physics.simulated_diameter).all()


def test_the_same_scene_has_the_same_bits(physics: PhysicsConfig) -> None:
    first, second, other = (pile_of(ANGLE, physics, scene=scene).world_from_obj for scene in (1, 1, 2))
    assert np.array_equal(first, second)
    assert not np.allclose(first, other)


def test_what_leaves_the_bin_is_put_back_until_it_stays(physics: PhysicsConfig) -> None:
    """Three balls in a row above a bin without a rim to speak of: the middle one drops between the others, or out."""
    body, size, put_back = body_of(BALL, physics), BinSize(0.24, 0.24, RIM), 0
    for scene in range(3):
        centers = np.array([[x, 0.0, 0.1 + 0.1 * scene] for x in (-0.11, 0.0, 0.13)]) * body.scale
        with world_of(body, size, physics) as world:
            counted = Counted(world)
            world.drop(centers, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))
            settled = settle(world, np.random.default_rng(scene))
            rest, _ = world.state()
        assert not settled or (np.abs(rest[:, :2]) <= np.array(size.reach) * body.scale).all()
        put_back += counted.put_back
    assert put_back > 0


def test_what_creeps_on_is_dropped_again_by_itself(physics: PhysicsConfig) -> None:
    """With no time to rest after the landing everything is dropped again, and again, until it is too much."""
    hurried = PHYSICS[physics.engine]().__class__(**{**physics.__dict__, "max_seconds": 0.0})
    body, size = body_of(ANGLE, physics), BinSize(0.3, 0.3, 0.1)
    with world_of(body, size, hurried) as world:
        counted = Counted(world)
        world.drop(np.array([[0.0, 0.0, 0.3]]) * body.scale, np.array([[0.6, 0.0, 0.0, 0.8]]))
        assert not settle(world, np.random.default_rng(0))
    assert counted.put_back == 1


def test_a_bin_that_cannot_hold_its_heap_is_reported_in_one_sentence(physics: PhysicsConfig) -> None:
    with pytest.raises(InputError, match="give a larger --bin or fewer --instances"):
        simulate_pile(body_of(BALL, physics), BinSize(0.11, 0.11, 0.01), (12, 12), physics, 0, 0)


def test_without_rapier_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rapier3d", None)
    monkeypatch.setattr("simgen.physics.engines.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'binpose-simgen\[rapier\]'"):
        require_engine("rapier")
    require_engine("pybullet")


def test_rapier_gives_the_same_bits_whatever_the_threads(physics: PhysicsConfig) -> None:
    if physics.engine != "rapier":
        pytest.skip("PyBullet has one thread")
    body, ends = body_of(ANGLE, physics), []
    for threads in (1, 2):
        with world_of(body, BinSize(0.3, 0.3, 0.1), physics) as world:
            world._world.set_num_threads(threads)  # type: ignore[attr-defined]
            world.drop(np.array([[0.0, 0.02 * i, 0.1 + 0.1 * i] for i in range(8)]) * body.scale, np.eye(4)[[0, 1] * 4])
            world.rest(1.0)
            ends.append(world.world_from_obj())
    assert np.array_equal(*ends)
