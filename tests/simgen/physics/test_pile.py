"""Piles: at rest, inside the bin, the same for every size, process and history."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from simgen.config_sections import BinSize, PhysicsConfig, PileConfig
from simgen.physics.bin_size import fitting_bin
from simgen.physics.body import Body, center_of_mass
from simgen.physics.engines import world_of
from simgen.physics.pile import Pile, simulate_pile
from simgen.physics.settling import settle
from simgen.physics.world import World

CONFIG = PhysicsConfig()
SHAPES = {
    "capsule": [trimesh.creation.capsule(0.04, 0.025, count=[10, 6]).convex_hull],
    "ball": [trimesh.creation.icosphere(2, 0.05)],
    "tile": [trimesh.creation.box([0.08, 0.05, 0.004])],
    "angle": [trimesh.creation.box([0.08, 0.03, 0.01]), trimesh.creation.box([0.01, 0.03, 0.06])],
}


def body_of(shape: str, scale: float = 1.0) -> Body:
    parts = [(np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces)) for mesh in SHAPES[shape]]
    return Body.from_parts(parts, CONFIG.simulated_diameter)


def bin_of(shape: str, scale: float = 1.0, count: int = 6) -> BinSize:
    return fitting_bin(np.vstack([mesh.vertices for mesh in SHAPES[shape]]) * scale, 0.1 * scale, count)


def pile_of(shape: str, scene: int = 0, scale: float = 1.0, count: tuple[int, int] = (4, 6)) -> Pile:
    return simulate_pile(body_of(shape, scale), bin_of(shape, scale, count[1]), count, CONFIG, 7, scene)


def standing(body: Body, size: BinSize, config: PhysicsConfig, pile: Pile) -> World:
    """A new world in which the pile's instances are where they came to rest."""
    world = world_of(body, size, config)
    centers = poses.apply(pile.world_from_obj, body.center_of_mass[None])[:, 0]
    world.drop(centers * body.scale, poses.to_quaternion_xyzw(pile.world_from_obj[:, :3, :3]))
    return world


def points_in_world(shape: str, pile: Pile, scale: float = 1.0) -> NDArray[np.float64]:
    """(instances, points, 3)."""
    vertices = np.vstack([mesh.vertices for mesh in SHAPES[shape]]) * scale
    return poses.apply(pile.world_from_obj, vertices)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_instance_lies_in_the_bin_and_above_its_floor(shape: str) -> None:
    for scene in range(3):
        pile = pile_of(shape, scene)
        points = points_in_world(shape, pile)
        size = bin_of(shape)
        assert 4 <= len(pile.world_from_obj) <= 6
        assert points[..., 2].min() > -5e-4
        assert (np.abs(points.mean(1)[:, 0]) < size.width / 2).all()
        assert (np.abs(points.mean(1)[:, 1]) < size.depth / 2).all()
        assert points[..., 2].min(1).min() < 1e-3, "somebody must lie on the floor"


@pytest.mark.parametrize("shape", SHAPES)
def test_piles_are_at_rest(shape: str) -> None:
    pile = pile_of(shape)
    with standing(body_of(shape), bin_of(shape), CONFIG, pile) as world:
        world.rest(CONFIG.quiet_window)
        later = world.world_from_obj()
    moved = np.abs(points_in_world(shape, Pile(later, 1)) - points_in_world(shape, pile)).max((1, 2))
    assert np.median(moved) < 1e-3, "a new world knows no contacts yet, so they give, and one instance may tip over"


def test_piles_whose_walls_were_lifted_off_are_at_rest_beyond_them() -> None:
    """They have rolled out, some of them; none beyond the bare ground's reach."""
    body, size = body_of("capsule"), bin_of("capsule", count=12)
    bare = BinSize(size.width, size.depth, size.height, walls=False)
    pile = simulate_pile(body, bare, (12, 12), CONFIG, 0, 0)
    again = simulate_pile(body, bare, (12, 12), CONFIG, 0, 0)
    assert np.array_equal(pile.world_from_obj, again.world_from_obj)
    aside = np.abs(points_in_world("capsule", pile).mean(1)[:, :2])
    assert (aside > size.reach).any()
    assert (aside <= bare.reach).all()
    with standing(body, bare, CONFIG, pile) as world:
        assert settle(world, np.random.default_rng(0))
        moved = np.abs(points_in_world("capsule", Pile(world.world_from_obj(), 1)) - points_in_world("capsule", pile))
    assert moved.max() < 3e-3


def test_drops_start_over_the_middle_of_the_bin_and_higher_as_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simgen.physics.pile.settle", lambda *_: True)  # poses are those of the start
    body, size = body_of("ball"), BinSize(1.0, 0.8, 0.3)
    start = PileConfig(drop_height_max=2.0, drop_spread_min=0.5)
    spread, lift = [], []
    for scene in range(40):
        begun = [simulate_pile(body, size, (30, 30), CONFIG, 0, scene, *config) for config in ((), (start,))]
        usual, asked = (pile.world_from_obj[:, :3, 3] for pile in begun)
        spread.append(float((np.abs(asked[:, :2]) / [0.5, 0.4]).max()))
        lift.append(asked[:, 2].min() - usual[:, 2].min())
    assert min(spread) < 0.6 and max(spread) > 0.85
    assert -0.05 < min(lift) < 0.03 and 0.16 < max(lift) < 0.25


def test_instances_do_not_pass_through_each_other() -> None:
    pile = pile_of("ball", count=(12, 12))
    centers = pile.world_from_obj[:, :3, 3]
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=-1)[~np.eye(len(centers), dtype=bool)]
    assert apart.min() > 0.1 * 0.98  # the ball is a polyhedron, a little thinner than its sphere


def test_a_scene_does_not_depend_on_what_was_simulated_before() -> None:
    fresh = pile_of("angle", scene=3).world_from_obj
    pile_of("ball", scene=1)
    pile_of("angle", scene=2)
    assert np.array_equal(pile_of("angle", scene=3).world_from_obj, fresh)


def test_another_process_simulates_the_same_bits() -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_pile as t; "
        "print(t.pile_of('angle', scene=3).world_from_obj.tobytes().hex())"
    )
    folder = __file__.rpartition("/")[0]
    printed = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, check=True).stdout
    assert printed.strip().splitlines()[-1] == pile_of("angle", scene=3).world_from_obj.tobytes().hex()


def test_scenes_differ_and_so_do_seeds() -> None:
    body, size = body_of("tile"), bin_of("tile", count=4)
    drawn = [simulate_pile(body, size, (4, 4), CONFIG, seed, scene) for seed, scene in ((0, 0), (0, 1), (1, 0), (1, 1))]
    for one, other in pairwise(drawn):
        assert not np.allclose(one.world_from_obj, other.world_from_obj)


@pytest.mark.parametrize("scale", [0.02, 20.0])
def test_a_screw_and_a_car_door_pile_up_like_a_cup(scale: float) -> None:
    points = points_in_world("angle", pile_of("angle", 0, scale), scale)
    assert -5e-4 * scale < points[..., 2].min() < 1e-3 * scale
    assert points[..., 2].max() < 0.2 * scale


def test_the_center_of_mass_is_that_of_the_volume() -> None:
    mesh = trimesh.creation.box([0.1, 0.2, 0.3])
    mesh.apply_translation([1.0, 2.0, 3.0])
    other = trimesh.creation.box([0.1, 0.2, 0.3])
    parts = [(np.asarray(m.vertices), np.asarray(m.faces)) for m in (mesh, other)]
    assert np.allclose(center_of_mass(parts[:1]), [1, 2, 3])
    assert np.allclose(center_of_mass(parts), [0.5, 1, 1.5])


def test_an_overfull_bin_is_reported_in_one_sentence() -> None:
    with pytest.raises(InputError, match="give a larger --bin or fewer --instances"):
        simulate_pile(body_of("ball"), BinSize(0.11, 0.11, 0.01), (12, 12), PhysicsConfig(max_attempts=2), 0, 0)
