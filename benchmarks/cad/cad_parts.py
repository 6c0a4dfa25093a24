"""Parts as CAD systems model them, of known volume, bodies and rotational symmetry, for `cad_table.py`.

Lengths in millimeters. Each part is one or more closed bodies; of several symmetries given, each is right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold, Mesh64
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROUND = 64  # sides of what is round
Point = tuple[float, float]


@dataclass(frozen=True)
class Part:
    """A part's `bodies`, the groups (`symmetry`) that are right, and their main axis where there is one."""

    name: str
    bodies: list[Manifold]
    symmetry: tuple[str, ...]
    axis: tuple[float, float, float] | None = None
    pieces: tuple[int, ...] = ()  # how many bodies that touch count for; empty for as many as there are

    @property
    def volume(self) -> float:
        """Cubic millimeters of all bodies."""
        return float(sum(body.volume() for body in self.bodies))

    def mesh(self) -> tuple[Array, NDArray[np.int64]]:
        """Vertices (V, 3) and faces (F, 3) of all bodies."""
        return joined([mesh_of(body) for body in self.bodies])


def mesh_of(body: Manifold) -> tuple[Array, NDArray[np.int64]]:
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, np.int64)


def joined(meshes: Sequence[tuple[Array, NDArray[np.int64]]]) -> tuple[Array, NDArray[np.int64]]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def box(x: float, y: float, z: float, at: Sequence[float] = (0, 0, 0)) -> Manifold:
    return Manifold.cube((x, y, z), True).translate(tuple(at))


def cylinder(radius: float, height: float, at: Sequence[float] = (0, 0, 0), axis: str = "z") -> Manifold:
    """About `axis`, its middle `at`."""
    body = Manifold.cylinder(height, radius, radius, ROUND, True)
    turns = {"x": (0.0, 90.0, 0.0), "y": (-90.0, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}
    return body.rotate(turns[axis]).translate(tuple(at))


def prism(outline: Sequence[Point] | Array, height: float, twist: float = 0.0, top: float = 1.0) -> Manifold:
    """An outline swept along z about the middle, twisted by degrees and scaled to its `top`."""
    steps = int(abs(twist) / 12)
    section = CrossSection([np.asarray(outline, float)])
    return Manifold.extrude(section, height, steps, twist, (top, top)).translate((0, 0, -height / 2))


def turned(profile: Sequence[Point]) -> Manifold:
    """A closed profile of (radius, height) around z."""
    return Manifold.revolve(CrossSection([np.asarray(profile, float)]), ROUND)


def ngon(sides: int, across_flats: float) -> Array:
    angle = (np.arange(sides) + 0.5) * (2 * np.pi / sides)
    return across_flats / 2 / np.cos(np.pi / sides) * np.stack([np.cos(angle), np.sin(angle)], -1)


def wavy(lobes: int, radius: float, depth: float, points: int = 96) -> Array:
    """An outline with `lobes` trapezoidal teeth: twisted, it is a thread of so many starts."""
    angle = np.arange(points) * (2 * np.pi / points)
    phase = (angle * lobes / (2 * np.pi)) % 1
    tooth = np.interp(phase, [0, 0.2, 0.35, 0.65, 0.8, 1], [0, 0, 1, 1, 0, 0])
    return (radius - depth + depth * tooth)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def tube_along(path: Array, radius: float, sides: int = 20, loop: bool = False) -> Manifold:
    """A round wire along a path (n, 3), with flat ends or in a loop."""
    ahead = np.roll(path, -1, 0) - np.roll(path, 1, 0) if loop else np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    normal = np.cross(ahead[0], [0.3, 0.5, 0.8])
    rings, angle = [], np.arange(sides) * (2 * np.pi / sides)
    for point, along in zip(path, ahead, strict=True):
        normal = normal - along * (normal @ along)
        normal /= np.linalg.norm(normal)
        across = np.cross(along, normal)
        rings.append(point + radius * (np.cos(angle)[:, None] * normal + np.sin(angle)[:, None] * across))
    count = len(path)
    k, s = np.mgrid[: count if loop else count - 1, :sides]
    shift = 0
    if loop:  # carried around the loop the frame comes back turned: the last ring meets the first by the nearest corner
        shift = int(np.linalg.norm(rings[-1][0] - rings[0], axis=1).argmin())
    ahead_s = np.where(k == count - 1, s + shift, s)
    here, there = k * sides, (k + 1) % count * sides
    a, b = here + s, here + (s + 1) % sides
    c, d = there + (ahead_s + 1) % sides, there + ahead_s % sides
    faces: list[NDArray[np.int64]] = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    vertices = np.concatenate(rings)
    if not loop:
        fan = np.arange(1, sides - 1)
        last = (count - 1) * sides
        faces += [np.stack([0 * fan, fan + 1, fan], -1), last + np.stack([0 * fan, fan, fan + 1], -1)]
    return Manifold(Mesh64(vertices, np.concatenate(faces).astype(np.uint64)))


def holes(body: Manifold, places: Sequence[Sequence[float]], radius: float) -> Manifold:
    for place in places:
        body -= cylinder(radius, 1e3, place)
    return body


def circle_of(count: int, radius: float) -> list[tuple[float, float, float]]:
    angles = np.arange(count) * (2 * np.pi / count)
    return [(radius * float(np.cos(a)), radius * float(np.sin(a)), 0.0) for a in angles]


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def threads_and_springs() -> list[Part]:
    turn = np.linspace(-5 * np.pi * 2 / 2, 5 * np.pi * 2 / 2, 161)
    helix = np.stack([12 * np.cos(turn), 12 * np.sin(turn), turn * (9 / (2 * np.pi))], -1)
    screw = prism(wavy(1, 4, 0.7, 40), 25, 25 / 1.5 * 360).translate((0, 0, -12.5)) + prism(
        ngon(6, 13), 5.3, 0
    ).translate((0, 0, 2.6))
    worm = prism(wavy(1, 10, 3), 40, 40 / 14 * 360) + cylinder(6, 70)
    return [
        Part("hex bolt, M8 thread", [screw], ("cyclic:6",), Z),
        Part("lead screw, 1 start", [prism(wavy(1, 12, 4), 60, 60 / 16 * 360)], ("cyclic:2",)),
        Part("lead screw, 2 starts", [prism(wavy(2, 12, 3), 60, 60 / 30 * 360)], ("dihedral:2",)),
        Part("lead screw, 3 starts", [prism(wavy(3, 12, 3), 60, 60 / 45 * 360)], ("dihedral:3",), Z),
        Part("worm on a shaft", [worm], ("cyclic:2",)),
        Part("coil spring", [tube_along(helix, 1.5)], ("cyclic:2",), X),
        Part("helical gear", [prism(wavy(17, 20, 4, 17 * 12), 14, 25) - cylinder(5, 50)], ("dihedral:17",), Z),
    ]


def sheet_metal() -> list[Part]:
    leg_a, leg_b = box(40, 30, 2, (20, 0, 1)), box(2, 30, 40, (1, 0, 20))
    angle = holes(leg_a + leg_b, [(28, 0, 0)], 4)
    even = angle - cylinder(4, 10, (0, 0, 28), "x")
    channel = box(80, 30, 2, (0, 0, 1)) + box(80, 2, 20, (0, 14, 10)) + box(80, 2, 20, (0, -14, 10))
    offset = box(30, 40, 2, (-14, 0, 15)) + box(2, 40, 30, (0, 0, 1)) + box(30, 40, 2, (14, 0, -15))
    tray = box(120, 80, 20) - box(118.4, 78.4, 20, (0, 0, 0.8))
    clip = [(0, 0), (30, 0), (30, 3), (3, 3), (3, 12), (20, 12), (20, 15), (0, 15)]
    return [
        Part("angle bracket, one hole", [angle], ("none",)),
        Part("angle bracket, two holes", [even], ("cyclic:2",), (1, 0, 1)),
        Part("channel", [channel], ("cyclic:2",), Z),
        Part("channel, one hole at an end", [holes(channel, [(32, 0, 0)], 4)], ("none",)),
        Part("joggled plate", [offset], ("cyclic:2",), Y),
        Part("tray, 0.8 mm walls", [tray], ("cyclic:2",), Z),
        Part("clip", [prism(clip, 12)], ("none",)),
        Part("slotted washer", [cylinder(20, 2) - cylinder(8, 9) - box(14, 5, 9, (16, 0, 0))], ("cyclic:2",), X),
    ]


def castings() -> list[Part]:
    square = [(-30, -30), (30, -30), (30, 30), (-30, 30)]
    pot = prism(square, 40, top=0.85) - prism([(0.9 * x, 0.9 * y) for x, y in square], 40, top=0.85).translate(
        (0, 0, -4)
    )
    long = prism([(-40, -20), (40, -20), (40, 20), (-40, 20)], 25, top=0.88)
    rib = long + box(4, 36, 12, (0, 0, 14))
    tee = cylinder(12, 80, axis="x") + cylinder(12, 45, (0, 0, 22.5))
    tee_hollow = tee - cylinder(9, 90, axis="x") - cylinder(9, 46, (0, 0, 23.5))
    jack = cylinder(5, 60) + cylinder(5, 60, axis="x") + cylinder(5, 60, axis="y")
    fan = cylinder(9, 16)
    for i in range(5):
        fan += box(15, 3, 12, (0, 0, 0)).rotate((35, 0, 0)).translate((14, 0, 0)).rotate((0, 0, 72 * i))
    wheel = turned(
        [
            (8, -10),
            (14, -10),
            (14, -3),
            (30, -3),
            (30, -8),
            (36, -8),
            (36, 8),
            (30, 8),
            (30, 3),
            (14, 3),
            (14, 10),
            (8, 10),
        ]
    )
    elbow = tube_along(np.stack([30 * np.cos(t := np.linspace(0, np.pi / 2, 25)), 30 * np.sin(t), 0 * t], -1), 10, 40)
    return [
        Part("drafted pot", [pot], ("cyclic:4",), Z),
        Part("drafted block with a rib", [rib], ("cyclic:2",), Z),
        Part("pipe tee", [tee_hollow], ("cyclic:2",), Z),
        Part("pipe elbow", [elbow], ("cyclic:2",), (1, 1, 0)),
        Part("jack", [jack], ("octahedral",)),
        Part("fan", [fan], ("dihedral:5",), Z),
        Part("fan with a nose", [fan + cylinder(7, 8, (0, 0, 12))], ("cyclic:5",), Z),
        Part("pulley", [wheel], ("revolution-flip",), Z),
        Part("pulley with spokes", [holes(wheel, circle_of(5, 22), 5)], ("dihedral:5",), Z),
        Part("pulley, one hole larger", [holes(holes(wheel, circle_of(5, 22), 5), [(22, 0, 0)], 7)], ("cyclic:2",), X),
    ]


def shafts_and_flanges() -> list[Part]:
    shaft, flange = cylinder(10, 80), cylinder(40, 8) - cylinder(12, 99)
    hub = flange + (cylinder(18, 20, (0, 0, 10)) - cylinder(12, 99))
    six = circle_of(6, 30)
    return [
        Part("rod, 2 x 300", [cylinder(1, 300)], ("revolution-flip",), Z),
        Part("shaft, keyway at one end", [shaft - box(6, 8, 25, (10, 0, 27))], ("none",)),
        Part("shaft, keyway in the middle", [shaft - box(6, 8, 25, (10, 0, 0))], ("cyclic:2",), X),
        Part("shaft with a flat along it", [shaft - box(6, 40, 99, (10.5, 0, 0))], ("cyclic:2",), X),
        Part("shaft with a flat at one end", [shaft - box(6, 40, 25, (10.5, 0, 30))], ("none",)),
        Part(
            "shaft, two flats at one end",
            [shaft - box(6, 40, 25, (10.5, 0, 30)) - box(6, 40, 25, (-10.5, 0, 30))],
            ("cyclic:2",),
            Z,
        ),
        Part("shaft, stepped", [shaft + cylinder(7, 40, (0, 0, 55))], ("revolution",), Z),
        Part("shaft, cross hole", [shaft - cylinder(3, 99, (0, 0, 28), "x")], ("cyclic:2",), Z),
        Part("hex nut", [prism(ngon(6, 17), 8) - cylinder(5, 99)], ("dihedral:6",), Z),
        Part("flange, 6 holes", [holes(flange, six, 4)], ("dihedral:6",), Z),
        Part("flange, hub, 6 holes", [holes(hub, six, 4)], ("cyclic:6",), Z),
        Part("flange, hub, one hole missing", [holes(hub, six[1:], 4)], ("none",)),
        Part("flange, one hole larger", [holes(holes(flange, six, 4), six[:1], 6)], ("cyclic:2",), X),
        Part("flange, hub, one hole larger", [holes(holes(hub, six, 4), six[:1], 6)], ("none",)),
        Part("disk with a locating pin", [flange + cylinder(3, 12, (30, 0, 8))], ("none",)),
    ]


def assemblies_and_sizes() -> list[Part]:
    outer, inner = turned([(22, -7), (30, -7), (30, 7), (22, 7)]), turned([(10, -7), (16, -7), (16, 7), (10, 7)])
    balls = [Manifold.sphere(4.5, 32).translate(place) for place in circle_of(8, 19)]
    leaf = box(30, 40, 2, (15, 0, 0))
    ring = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    link = np.stack([14 * np.cos(ring), 9 * np.sin(ring), 0 * ring], -1)
    housing = box(60, 40, 30) - box(50, 30, 20)
    return [
        Part("ball bearing", [outer, inner, *balls], ("dihedral:8",), Z),
        Part(
            "hinge",
            [leaf.translate((3.5, 0, 0)), leaf.rotate((0, 0, 180)).translate((-3.5, 0, 0)), cylinder(3, 42, axis="y")],
            ("dihedral:2",),
        ),
        Part("housing with a part inside", [housing, box(20, 12, 8, (10, 4, 2))], ("dihedral:2",)),
        Part(
            "block with a pressed pin",
            [box(50, 30, 20) - cylinder(5, 40, (15, 0, 0)), cylinder(5, 40, (15, 0, 0))],
            ("cyclic:2",),
            X,
        ),
        Part(
            "block with a flush pin",
            [box(50, 30, 20) - cylinder(5, 40, (15, 0, 0)), cylinder(5, 20, (15, 0, 0))],
            ("dihedral:2",),
            pieces=(1,),
        ),
        Part(
            "two blocks face to face",
            [box(30, 30, 20, (-15, 0, 0)), box(30, 30, 20, (15, 0, 0))],
            ("dihedral:2",),
            pieces=(1,),
        ),
        Part(
            "two blocks edge to edge",
            [box(30, 30, 20, (-15, -15, 0)), box(30, 30, 20, (15, 15, 0))],
            ("dihedral:2",),
            pieces=(1, 2),
        ),
        Part("chain link", [tube_along(link, 3, loop=True)], ("dihedral:2",)),
        Part("ball", [Manifold.sphere(15, 64)], ("sphere",)),
        Part("ball with a bore", [Manifold.sphere(15, 64) - cylinder(5, 99)], ("revolution-flip",), Z),
        Part("tiny screw, 3 mm", [cylinder(0.5, 2.2) + cylinder(1, 0.8, (0, 0, 1.4))], ("revolution",), Z),
        Part("beam, 0.8 m", [box(800, 60, 60) - box(900, 50, 50)], ("dihedral:4",), X),
        Part("panel, 0.6 m, one corner cut", [box(600, 400, 20) - box(120, 120, 99, (300, 200, 0))], ("none",)),
        Part("spring pin, slotted", [cylinder(5, 40) - cylinder(4, 99) - box(9, 2, 99, (5, 0, 0))], ("cyclic:2",), X),
        Part("block, 40 x 36 x 20", [box(40, 36, 20)], ("dihedral:2",)),
        Part(
            "block with chamfered corner", [box(40, 40, 40).trim_by_plane((-1, -1, -1), -22)], ("cyclic:3",), (1, 1, 1)
        ),
    ]


GROUPS: tuple[Callable[[], list[Part]], ...] = (
    threads_and_springs, sheet_metal, castings, shafts_and_flanges, assemblies_and_sizes,
)  # fmt: skip


def all_parts() -> list[Part]:
    """Every part, in a fixed order."""
    return [part for group in GROUPS for part in group()]
