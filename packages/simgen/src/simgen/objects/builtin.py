"""Objects that need no file: known by name, in meters, z up.

The bunny comes out of PyBullet's wheel. The others are modeled here, one of each class of symmetry that bin picking
knows: turned parts, a gear, and parts of blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from simgen.objects.mending import mend

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
BUNNY_METERS_PER_UNIT = 0.05  # nose to tail 1.97 units in the file: a 10 cm bunny
SECTIONS = 64  # around a turned part


@dataclass(frozen=True)
class BuiltinObject:
    """A named object: `make` gives vertices (V, 3) in meters and faces (F, 3); `origin` says where they come from."""

    make: Callable[[], Mesh]
    symmetry: str
    origin: str


def bunny() -> Mesh:
    """PyBullet's bunny.obj (902 faces), one round of Loop subdivision (3608), turned from y up to z up, 10 cm long."""
    import pybullet_data  # only here: the other objects, distractors among them, are drawn where PyBullet is not

    mesh = trimesh.load_mesh(Path(pybullet_data.getDataPath()) / "bunny.obj", process=False)
    vertices, faces = trimesh.remesh.subdivide_loop(mesh.vertices, mesh.faces, iterations=1)
    x, y, z = np.asarray(vertices, float).T * BUNNY_METERS_PER_UNIT
    return np.stack([x, -z, y], -1), np.asarray(faces, np.int64)


def cup() -> Mesh:
    """A coffee cup without a handle, 10 cm high, with a rolled lip."""
    outside = [(0, 0), (28, 0), (28.5, 2), (38, 94), (40.5, 95), (41.5, 97.5), (40.5, 100)]
    inside = [(38, 99), (35.5, 94), (26, 6), (24, 4), (0, 4)]
    return _turned([*outside, *inside])


def candlestick() -> Mesh:
    """Foot, stem with a ring, and a socket for the candle; 13 cm high."""
    foot_and_stem = [
        (0, 0),
        (38, 0),
        (40, 2),
        (38, 6),
        (20, 10),
        (10, 18),
        (7, 30),
        (7, 48),
        (12, 52),
        (14, 56),
        (12, 60),
    ]
    socket = [(7, 64), (7, 92), (12, 100), (20, 104), (22, 108), (22, 130), (18, 130), (18, 112), (0, 112)]
    return _turned([*foot_and_stem, *socket])


def pepper() -> Mesh:
    """A pepper mill: waisted body and a knob; 14 cm high."""
    body = [(0, 0), (28, 0), (29, 3), (27, 12), (20, 35), (17, 52), (19, 72), (25, 88), (25, 94), (18, 98)]
    cap = [(24, 101), (26, 108), (23, 117), (14, 123), (7, 125), (9, 130), (9, 135), (6, 139), (0, 140)]
    return _turned([*body, *cap])


def gear() -> Mesh:
    """A spur gear of 16 teeth with a bore and a hub on one side; 9 cm across."""
    teeth, points_a_tooth, tooth_height = 16, 12, 0.16
    phase = np.arange(teeth * points_a_tooth) / points_a_tooth % 1.0
    outline = 1.0 - tooth_height * np.interp(phase, [0.0, 0.3, 0.42, 0.88, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0])
    profile = [(9, 0), (45, 0), (45, 16), (18, 16), (18, 28), (9, 28)]
    return _turned(profile, np.stack([outline if radius == 45 else np.ones_like(outline) for radius, _ in profile]))


def brick() -> Mesh:
    """Three different sides and a slot through the middle; 10 cm long."""
    filled = np.ones((3, 3, 1), bool)
    filled[1, 1] = False
    return _blocks([0, 35, 65, 100], [0, 20, 40, 60], [0, 38], filled)


def connector() -> Mesh:
    """A plug housing: a base with two towers set aslant from each other, so that only half a turn maps it to itself."""
    filled = np.zeros((5, 4, 3), bool)
    filled[:, :, 0] = True
    filled[1, 0:2, 1:] = True
    filled[3, 2:4, 1:] = True
    filled[0, :, 0], filled[4, :, 0] = [True, True, False, False], [False, False, True, True]
    return _blocks([0, 14, 34, 46, 66, 80], [0, 10, 25, 40, 50], [0, 14, 30, 42], filled)


def bracket() -> Mesh:
    """An angle with one leg notched and a stop on one side: no symmetry at all."""
    filled = np.zeros((4, 3, 4), bool)
    filled[:, :, 0] = True
    filled[0, :, :] = True
    filled[3, 2, 0] = False
    filled[0, 0, 3] = False
    filled[2, 0, 1] = True
    return _blocks([0, 12, 40, 56, 80], [0, 14, 32, 50], [0, 12, 30, 48, 66], filled)


def _turned(profile_mm: Sequence[tuple[float, float]], swell: NDArray[np.float64] | None = None) -> Mesh:
    """A closed profile of (radius, height) in millimeters swept around z; axis to axis, or around a bore.

    `swell` (profile points, sections) multiplies the radius by section, as teeth need.
    """
    radius, height = np.array(profile_mm, float).T * 1e-3
    radii = radius[:, None] * (np.ones((1, SECTIONS)) if swell is None else swell)
    points, sections = radii.shape
    angle = np.arange(sections) * (2 * np.pi / sections)
    vertices = np.stack(
        [radii * np.cos(angle), radii * np.sin(angle), np.broadcast_to(height[:, None], radii.shape)], -1
    )
    k, s = np.mgrid[:points, :sections]
    here, ahead = k * sections + s, (k + 1) % points * sections + s
    here_next, ahead_next = k * sections + (s + 1) % sections, (k + 1) % points * sections + (s + 1) % sections
    triangles = [np.stack([here, here_next, ahead_next], -1), np.stack([here, ahead_next, ahead], -1)]
    return _cleaned(vertices.reshape(-1, 3), np.concatenate(triangles).reshape(-1, 3))


def _blocks(x_mm: ArrayLike, y_mm: ArrayLike, z_mm: ArrayLike, filled: NDArray[np.bool_]) -> Mesh:
    """The surface of the `filled` (nx, ny, nz) cells between the planes at x, y and z, in millimeters, centered."""
    planes = [np.asarray(p, float) * 1e-3 - np.ptp(np.asarray(p, float)) * 0.5e-3 for p in (x_mm, y_mm, z_mm)]
    shape = tuple(len(plane) for plane in planes)
    vertices = np.stack(np.meshgrid(*planes, indexing="ij"), -1).reshape(-1, 3)
    faces = [_walls(filled, axis, shape) for axis in range(3)]
    return _cleaned(vertices, np.concatenate(faces))


def _walls(filled: NDArray[np.bool_], axis: int, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Triangles (n, 3) between filled and empty neighbors along `axis`, seen counter-clockwise from the empty side."""
    padded = np.pad(filled.astype(int), [(1, 1) if i == axis else (0, 0) for i in range(3)])
    step = np.moveaxis(np.diff(padded, axis=axis), axis, 0)  # 1 where it gets filled along the axis, -1 where empty
    corners = np.moveaxis(np.arange(np.prod(shape)).reshape(shape), axis, 0)
    a, b, c, d = corners[:, :-1, :-1], corners[:, 1:, :-1], corners[:, 1:, 1:], corners[:, :-1, 1:]
    quads = np.stack([a, b, c, d], -1)
    along = quads if axis != 1 else quads[..., ::-1]  # moving y to the front makes the frame left-handed
    outward = np.concatenate([along[step == -1], along[step == 1][:, ::-1]])
    return np.concatenate([outward[:, [0, 1, 2]], outward[:, [0, 2, 3]]])


def _cleaned(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Mesh:
    mesh = mend(vertices, faces)
    return mesh.vertices, mesh.faces


BUILTIN_OBJECTS: dict[str, BuiltinObject] = {
    "bunny": BuiltinObject(bunny, "none", "bunny.obj of pybullet_data, subdivided once, 10 cm long"),
    "cup": BuiltinObject(cup, "revolution", "a coffee cup without a handle, 10 cm high, modeled here"),
    "candlestick": BuiltinObject(candlestick, "revolution", "a candlestick, 13 cm high, modeled here"),
    "pepper": BuiltinObject(pepper, "revolution", "a pepper mill, 14 cm high, modeled here"),
    "gear": BuiltinObject(gear, "cyclic:16", "a spur gear with a hub, 9 cm across, modeled here"),
    "brick": BuiltinObject(brick, "dihedral:2", "a slotted brick, 10 cm long, modeled here"),
    "connector": BuiltinObject(connector, "cyclic:2", "a plug housing, 8 cm long, modeled here"),
    "bracket": BuiltinObject(bracket, "none", "a notched angle bracket, 8 cm long, modeled here"),
}
