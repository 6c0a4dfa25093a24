"""More parts as CAD systems model them, for `cad_table.py`: profiles, fittings, fasteners, cams. See `cad_parts.py`."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cad_parts import (
    Array,
    Part,
    X,
    Y,
    Z,
    box,
    circle_of,
    cylinder,
    holes,
    ngon,
    prism,
    tube_along,
    wavy,
)


def profiles() -> list[Part]:
    slot = box(4.2, 6, 99, (0, 18, 0)) + box(9, 4, 99, (0, 14, 0))
    extrusion = box(40, 40, 60) - cylinder(2.5, 99)
    for turn in range(4):
        extrusion -= slot.rotate((0, 0, 90 * turn))
    tube = box(100, 40, 20) - box(110, 36, 16)
    angle = [(0, 0), (40, 0), (40, 4), (4, 4), (4, 40), (0, 40)]
    zed = [(-2, -30), (20, -30), (20, -26), (2, -26), (2, 30), (-20, 30), (-20, 26), (-2, 26)]
    beam = box(50, 4, 90, (0, 28, 0)) + box(50, 4, 90, (0, -28, 0)) + box(4, 56, 90)
    return [
        Part("T-slot extrusion", [extrusion], ("dihedral:4",), Z),
        Part("T-slot extrusion, hole at an end", [extrusion - cylinder(4, 99, (0, 0, 20), "x")], ("cyclic:2",), Z),
        Part("square tube", [box(30, 30, 100) - box(26, 26, 110)], ("dihedral:4",), Z),
        Part("rectangular tube, hole at an end", [holes(tube, [(30, 0, 0)], 5)], ("cyclic:2",), X),
        Part("L profile", [prism(angle, 100)], ("cyclic:2",), (1, 1, 0)),
        Part("Z profile", [prism(zed, 100)], ("cyclic:2",), Z),
        Part("I beam", [beam], ("dihedral:2",)),
    ]


def pipes() -> list[Part]:
    branches = [cylinder(8, 50, (0, 0, 25)).rotate((0, 120 * i, 0)) for i in range(3)]
    bores = [cylinder(6, 60, (0, 0, 30)).rotate((0, 120 * i, 0)) for i in range(3)]
    fork = [cylinder(8, 50, (0, 0, 25)).rotate((0, turn, 0)) for turn in (35, -35, 180)]
    elbow, half = tube_along(_arc(40, np.pi / 4), 8, 40), cylinder(20, 60) - cylinder(17, 99)
    half = half.trim_by_plane((1, 0, 0), 0)
    flanged = elbow + cylinder(15, 4, (40, 2, 0), "y")
    return [
        Part("three pipes at 120 degrees", [_joined(branches) - _joined(bores)], ("dihedral:3",), Y),
        Part("fork of pipes", [_joined(fork)], ("cyclic:2",), Z),
        Part("elbow of 45 degrees", [elbow], ("cyclic:2",), (np.cos(np.pi / 8), np.sin(np.pi / 8), 0)),
        Part("elbow with a flange at one end", [flanged], ("none",)),
        Part("half shell", [half], ("cyclic:2",), X),
        Part("half shell with a tab at one end", [half + box(4, 8, 6, (21, 0, 27))], ("none",)),
    ]


def wires_and_clips() -> list[Part]:
    down, bow = np.array([[-15.0, y, 0.0] for y in np.linspace(60, 3, 20)]), np.linspace(np.pi, 2 * np.pi, 25)
    hook = np.concatenate([down, np.stack([15 * np.cos(bow), 15 * np.sin(bow), 0 * bow], -1)])
    arc = np.linspace(0.25 * np.pi, 1.5 * np.pi, 30)
    upper = np.stack([14 * np.cos(arc), 14 * np.sin(arc) + 14, 0 * arc], -1)
    clip = cylinder(20, 2) - cylinder(16, 9) - box(20, 6, 9, (18, 0, 0))
    clip += cylinder(3, 2, (18, 6, 0)) + cylinder(3, 2, (18, -6, 0))
    return [
        Part("hook", [tube_along(hook, 3)], ("none",)),
        Part("S-hook", [tube_along(np.concatenate([upper, -upper[-2::-1]]), 3)], ("cyclic:2",), Z),
        Part("circlip", [clip], ("cyclic:2",), X),
    ]


def fasteners_and_cams() -> list[Part]:
    shank = cylinder(4, 30, (0, 0, -15))
    wing = box(14, 3, 12, (12, 0, 8))
    wing_nut = cylinder(8, 10) + wing + wing.rotate((0, 0, 180)) - cylinder(3, 99)
    sprocket = prism(wavy(12, 30, 6, 144), 8) - cylinder(8, 99)
    flange = holes(cylinder(40, 8) - cylinder(12, 99), circle_of(4, 30), 4)
    key = box(8, 8, 99, (12, 0, 0))
    shaft, cam = cylinder(8, 100), cylinder(14, 10, (7, 0, 0))
    quarter = [cam.translate((0, 0, 20)), cam.rotate((0, 0, 90)).translate((0, 0, -20))]
    opposite = [cam.translate((0, 0, 20)), cam.rotate((0, 0, 180)).translate((0, 0, -20))]
    uneven = [cam.translate((0, 0, 30)), cam.rotate((0, 0, 90)).translate((0, 0, -10))]
    return [
        Part("hex bolt, plain shank", [prism(ngon(6, 13), 5.3).translate((0, 0, 2.6)) + shank], ("cyclic:6",), Z),
        Part("standoff with a stud", [prism(ngon(6, 8), 20) + cylinder(2.5, 10, (0, 0, 14))], ("cyclic:6",), Z),
        Part("spacer", [cylinder(8, 12) - cylinder(4, 99)], ("revolution-flip",), Z),
        Part("wing nut", [wing_nut], ("cyclic:2",), Z),
        Part("sprocket", [sprocket], ("dihedral:12",), Z),
        Part("sprocket with a keyway", [sprocket - box(6, 6, 99, (8, 0, 0))], ("cyclic:2",), X),
        Part("flange, keyway", [flange - key], ("cyclic:2",), X),
        Part("flange, hub, keyway", [flange + (cylinder(18, 20, (0, 0, 10)) - cylinder(12, 99)) - key], ("none",)),
        Part("cam shaft, cams at 90 degrees", [_joined([shaft, *quarter])], ("cyclic:2",), (1, 1, 0)),
        Part("cam shaft, cams at 180 degrees", [_joined([shaft, *opposite])], ("cyclic:2",), Y),
        Part("cam shaft, cams apart", [_joined([shaft, *uneven])], ("none",)),
    ]


def _arc(radius: float, angle: float) -> Array:
    t = np.linspace(0, angle, 25)
    return np.stack([radius * np.cos(t), radius * np.sin(t), 0 * t], -1)


def _joined(bodies: list[Manifold]) -> Manifold:
    joined = bodies[0]
    for body in bodies[1:]:
        joined += body
    return joined


def more_parts() -> list[Part]:
    """Every part of this page, in a fixed order."""
    return [*profiles(), *pipes(), *wires_and_clips(), *fasteners_and_cams()]
