"""The bin: how large, and what differs from scene to scene."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from simgen.config_sections import BinSize, PileConfig
from simgen.physics.bin_shape import bin_mesh, wall_boxes
from simgen.physics.bin_size import PACKING, fill_level, fitting_bin, scene_bin, smallest_bin

SIZE = BinSize(0.4, 0.3, 0.1)
TILE = np.asarray(trimesh.creation.box([0.08, 0.05, 0.004]).vertices)


def test_more_layers_make_a_smaller_bin_of_the_asked_for_shape() -> None:
    flat, deep = (fitting_bin(TILE, 0.1, 80, PileConfig(layers=n, aspect=1.25, wall_height=1.5)) for n in (1.0, 2.0))
    assert flat.width * flat.depth == pytest.approx(2 * deep.width * deep.depth)
    assert deep.width / deep.depth == pytest.approx(1.25)
    assert deep.height == pytest.approx(0.15)


def test_the_smallest_bin_of_a_scene_has_room_for_all() -> None:
    """Or its drops would be redone until the attempts are used up, and a build die of one scene."""
    pile = PileConfig(layers=9.0, bin_jitter=0.3)
    size = fitting_bin(TILE, 0.1, 80, pile)
    smallest = smallest_bin(pile, size)
    assert fill_level(TILE, smallest, 80) <= PACKING + 1e-9
    assert all(scene_bin(pile, size, 0, scene).width >= smallest.width for scene in range(100))
    lonely = smallest_bin(PileConfig(bin_jitter=0.5), fitting_bin(TILE, 0.1, 1, PileConfig(bin_jitter=0.5)))
    assert min(lonely.width, lonely.depth) > 0.1


def test_without_jitter_every_scene_has_the_datasets_bin() -> None:
    assert all(scene_bin(PileConfig(), SIZE, 7, scene) == SIZE for scene in range(20))


def test_scenes_bins_differ_within_their_bounds() -> None:
    pile = PileConfig(bin_jitter=0.2)
    sides = np.array([(size.width, size.depth) for size in (scene_bin(pile, SIZE, 0, s) for s in range(300))])
    share = sides / [SIZE.width, SIZE.depth]
    assert 0.8 <= share.min() < 0.82 and 1.18 < share.max() <= 1.2
    assert abs(np.corrcoef(share.T)[0, 1]) < 0.2, "each side by itself"


def test_a_scenes_bin_depends_on_seed_and_scene_alone() -> None:
    pile = PileConfig(bin_jitter=0.2, wall_probability=0.5)
    assert scene_bin(pile, SIZE, 3, 4) == scene_bin(pile, SIZE, 3, 4)
    assert len({scene_bin(pile, SIZE, seed, scene) for seed in range(3) for scene in range(3)}) == 9


def test_walls_are_there_as_often_as_asked_for() -> None:
    walls = [scene_bin(PileConfig(wall_probability=0.7), SIZE, 0, scene).walls for scene in range(500)]
    assert 0.63 < np.mean(walls) < 0.77
    assert not any(scene_bin(PileConfig(), BinSize(1, 1, 1, walls=False), 0, scene).walls for scene in range(9))


def test_a_bin_without_walls_is_the_ground_alone() -> None:
    bare = BinSize(0.4, 0.3, 0.1, walls=False)
    assert len(wall_boxes(bare, 0.01)) == 0
    vertices, faces = bin_mesh(bare)
    assert (vertices[:, 2] == 0).all() and len(faces) == 2
    assert bare.reach[0] > SIZE.reach[0] == 0.2
