"""What a camera sees decides on symmetry: openings break it wherever they are, and matching ones do not."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import ArrayLike
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import Delaunay

from evalkit.geometry import poses
from evalkit.objects.depth_views import DepthViews, dense_samples
from evalkit.objects.sight import telling_elements, within_circle
from evalkit.objects.symmetry import Symmetry, _closure
from evalkit.objects.symmetry_detection import detect_symmetry, resolve_symmetry
from evalkit.objects.symmetry_fit import same_axis

Array = np.ndarray


def circle(x: float, y: float, radius: float) -> Array:
    angle = np.arange(32) * (2 * np.pi / 32)
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])


def rectangle(x: float, y: float, width: float, depth: float, step: float = 1.0) -> Array:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [width / 2, depth / 2] + [x, y]
    sides = zip(corners, np.roll(corners, -1, 0), strict=True)
    return np.concatenate([np.linspace(a, b, int(np.linalg.norm(b - a) / step) + 1)[:-1] for a, b in sides])


def plate(outline: Array, holes: list[Array], thickness: float) -> trimesh.Trimesh:
    """An outline (n, 2) with holes, raised along z."""
    loops = [outline, *holes]
    points = np.concatenate(loops)
    triangles = Delaunay(points).simplices
    middles = points[triangles].mean(1)
    solid = within(middles, outline) & ~np.any([within(middles, hole) for hole in holes] or [[False]], axis=0)
    triangles, count = triangles[solid], len(points)
    a, b, c = points[triangles].swapaxes(0, 1)
    reversed_ = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[reversed_] = triangles[reversed_, ::-1]
    faces, first = [triangles[:, ::-1], triangles + count], 0
    for loop in loops:
        i = np.arange(len(loop)) + first
        j = np.roll(i, -1)
        faces += [np.column_stack([i, j, j + count]), np.column_stack([i, j + count, i + count])]
        first += len(loop)
    vertices = [np.column_stack([points, np.full(count, z)]) for z in (0.0, thickness)]
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def within(points: Array, loop: Array) -> Array:
    x, y = points.T
    inside = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(loop, np.roll(loop, -1, 0), strict=True):
        inside ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0 + 1e-300) + x0)
    return inside


def disk_holes(count: int, at: float, radius: float) -> list[Array]:
    angle = 0.3 + np.arange(count) * (2 * np.pi / count)
    return [circle(at * np.cos(a), at * np.sin(a), radius) for a in angle]


def bar(length: float, width: float, thickness: float, hole: float) -> trimesh.Trimesh:
    outline = rectangle(length / 2, width / 2, length, width, 2.0)
    return plate(outline, [circle(width / 2, width / 2, hole / 2)], thickness)


PARTS = {
    "bar with a hole at one end": ("cyclic:2", bar(200, 10, 4, 8)),
    "wider bar with a hole at one end": ("cyclic:2", bar(300, 30, 5, 12)),
    "square plate with a slot at one edge": (
        "cyclic:2", plate(rectangle(50, 50, 100, 100), [rectangle(12, 50, 4, 20)], 4)
    ),
    "plate with a hole in one corner": ("none", plate(rectangle(50, 30, 100, 60, 2.0), [circle(10, 10, 2.5)], 3)),
    "plate with holes in opposite corners": (
        "cyclic:2", plate(rectangle(50, 30, 100, 60, 2.0), [circle(10, 10, 2.5), circle(90, 50, 2.5)], 3)
    ),
    "plate with four holes": (
        "dihedral:2",
        plate(rectangle(50, 30, 100, 60, 2.0), [circle(x, y, 2.5) for x in (8, 92) for y in (8, 52)], 3),
    ),
    "disk with six small holes": ("dihedral:6", plate(circle(0, 0, 50), disk_holes(6, 35, 2.5), 5)),
    "disk with one small hole": ("cyclic:2", plate(circle(0, 0, 50), disk_holes(1, 35, 2.5), 5)),
}  # fmt: skip


@pytest.mark.parametrize("name", PARTS)
def test_a_small_opening_breaks_the_symmetries_that_it_does_not_share(name: str) -> None:
    expected, mesh = PARTS[name]
    rng = np.random.default_rng(len(name))
    turned = mesh.vertices @ poses.random_rotations(rng, 1)[0].T * 1e-3 + rng.normal(size=3)
    found = detect_symmetry(turned, mesh.faces)
    assert found.symmetry.name == expected
    assert found.evidence is None or found.evidence.sight_excess <= 1.0


def test_a_hole_in_a_ball_leaves_the_turns_about_it() -> None:
    height = np.linspace(-np.pi / 2, np.arccos(0.1), 40)
    profile = [*np.column_stack([np.cos(height), np.sin(height)]), (0.1, 0.6), (0.0, 0.6)]
    ball = trimesh.creation.revolve(np.abs(profile) * np.sign([[1, y] for _, y in profile]), sections=64)
    rotation = poses.random_rotations(np.random.default_rng(3), 1)[0]
    found = detect_symmetry(ball.vertices @ rotation.T, ball.faces).symmetry
    assert found.name == "revolution" and same_axis(found.axis, rotation[:, 2], np.radians(1.0))


def test_a_symmetry_that_is_asked_for_is_judged_by_sight_too() -> None:
    mesh = bar(200, 10, 4, 8)
    wrong = resolve_symmetry(mesh.vertices, mesh.faces, "cyclic:2@z").candidates[0]
    assert wrong.only_seen_to_be_wrong and not wrong.accepted


@pytest.mark.parametrize(
    "corners", [np.eye(3), [[0, 0, 0], [1, 0, 0], [0.9, 0.02, 0]], [[0, 0, 0], [1, 0, 0], [2, 0, 0]]]
)
def test_every_point_of_a_triangle_is_near_a_sample(corners: ArrayLike) -> None:
    corners = np.asarray(corners, float)
    samples, _, _ = dense_samples(corners, [[0, 1, 2]], 0.05)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), 2000)
    distance = np.linalg.norm((weights @ corners)[:, None] - samples[None], axis=2).min(1)
    assert distance.max() <= 0.05 * np.sqrt(0.5) + 1e-9


def test_a_solid_has_no_gaps_in_any_view() -> None:
    cube = trimesh.creation.box((1, 1, 1))
    views = DepthViews(cube.vertices / np.sqrt(0.75), cube.faces, 120)
    for rotation in poses.random_rotations(np.random.default_rng(1), 10):
        filled = np.isfinite(views.from_both_ends(rotation)[0])
        assert filled.sum() > 3000
        for row in filled[filled.any(1)]:  # a convex body covers one run of pixels in each row
            first, last = np.flatnonzero(row)[[0, -1]]
            assert row[first : last + 1].all()


@pytest.mark.parametrize("radius", [1.0, 2.0, 3.7])
def test_the_extremes_within_a_circle_are_those_of_each_pixels_neighbors(radius: float) -> None:
    """Against scipy's filters, which take any neighborhood and ten times as long."""
    images = np.random.default_rng(0).normal(size=(2, 17, 23)).astype(np.float32)
    reach = int(radius)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    circle = x * x + y * y <= radius**2
    for ours, theirs in ((np.minimum, minimum_filter), (np.maximum, maximum_filter)):
        expected = [theirs(image, footprint=circle, mode="constant", cval=np.inf) for image in images]
        assert np.array_equal(within_circle(images, radius, ours), expected)


@pytest.mark.parametrize(
    "name",
    ["cyclic:2", "cyclic:4", "cyclic:30", "dihedral:2", "dihedral:7", "tetrahedral", "octahedral", "icosahedral"],
)
def test_the_elements_that_are_looked_at_generate_their_group(name: str) -> None:
    group = Symmetry.parse(name)
    assert len(_closure(list(telling_elements(group)))) == len(group.rotations)
