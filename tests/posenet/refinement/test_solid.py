"""How deep things lie within objects, whatever their mesh leaves open."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel, sample_surface_with_normals
from posenet.refinement.solid import Solid, close_pairs, interpenetration

ONE = np.zeros(2, np.int64)


def model_of(mesh: trimesh.Trimesh) -> ObjectModel:
    return ObjectModel.from_mesh("thing", np.asarray(mesh.vertices), np.asarray(mesh.faces))


@pytest.fixture(scope="module")
def block() -> ObjectModel:
    return model_of(trimesh.creation.box((0.06, 0.05, 0.04)))


def shifted(along: float) -> np.ndarray:
    second = np.eye(4)
    second[2, 3] = along
    return np.stack([np.eye(4), second])


@pytest.mark.parametrize(("apart", "deep"), [(0.06, 0.0), (0.0402, 0.0), (0.036, 0.004), (0.03, 0.010), (0.025, 0.015)])
def test_blocks_interpenetrate_by_what_they_overlap(block: ObjectModel, apart: float, deep: float) -> None:
    points, _ = sample_surface_with_normals(block.vertices, block.faces, 500)
    (found,) = interpenetration([Solid(block)], ONE, shifted(apart), np.array([[0, 1]]), points[None])
    assert found == pytest.approx(deep, abs=0.002)


def test_it_does_not_matter_where_both_lie(block: ObjectModel) -> None:
    points, _ = sample_surface_with_normals(block.vertices, block.faces, 500)
    turn = poses.from_axis_angle([0.3, -0.5, 0.8], 1.1)
    moved = poses.from_rotation_translation(turn, [0.2, -0.1, 0.9]) @ shifted(0.03)
    solid, pair = Solid(block), np.array([[0, 1]])
    straight = interpenetration([solid], ONE, shifted(0.03), pair, points[None])
    assert interpenetration([solid], ONE, moved, pair, points[None]) == pytest.approx(straight, abs=0.001)
    assert interpenetration([solid], ONE, moved, pair[:, ::-1], points[None]) == pytest.approx(straight, abs=0.001)


def test_different_parts_interpenetrate_as_two_of_one_do(block: ObjectModel) -> None:
    """A pin of 10 x 10 x 40 mm in the block, and the reverse."""
    pin = model_of(trimesh.creation.box((0.01, 0.01, 0.04)))
    points = np.stack([sample_surface_with_normals(part.vertices, part.faces, 500)[0] for part in (block, pin)])
    solids, pair = [Solid(block), Solid(pin)], np.array([[0, 1]])
    apart, inside = (
        interpenetration(solids, np.array([0, 1]), shifted(along), pair, points)[0] for along in (0.041, 0.03)
    )
    assert apart == pytest.approx(0, abs=0.002) and inside == pytest.approx(0.01, abs=0.003)
    assert interpenetration(solids[::-1], np.array([1, 0]), shifted(0.03), pair, points[::-1])[0] == inside


def test_the_hollow_of_a_cup_is_outside_though_its_mesh_is_a_mere_sheet() -> None:
    pipe = trimesh.creation.cylinder(0.03, 0.08, sections=48)
    sheet = model_of(trimesh.Trimesh(pipe.vertices, pipe.faces[pipe.face_normals[:, 2] < 0.5], process=False))
    closed = model_of(pipe)
    middle = 16
    assert Solid(sheet).depth[middle, middle, middle] == 0.0
    assert Solid(closed).depth[middle, middle, middle] > 0.025


def test_close_pairs_are_all_and_only_those_within_reach() -> None:
    centers = np.random.default_rng(0).uniform(0, 1, (40, 3))
    expected = {(i, j) for i in range(40) for j in range(i + 1, 40) if np.linalg.norm(centers[i] - centers[j]) < 0.3}
    assert {tuple(pair) for pair in close_pairs(centers, 0.3).tolist()} == expected
