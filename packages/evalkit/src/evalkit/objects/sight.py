"""Whether a turned surface looks as it did: depth images compared over views.

Distances to the surface do not see an opening: a turned point that lies in a hole is half the hole's width off at
most, however plainly a camera looks through it. So what a camera sees decides too. A pixel of one image is explained
by another where some surface within a small circle about it is as deep; a hole's middle is explained by no solid plate
and a plate by no hole. The circle and the depth's tolerance absorb tessellation and noise; slivers a pixel wide, which
come and go with the sampling where one looks through a gap, do not count.
"""

from __future__ import annotations

from math import gcd

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes
from evalkit.objects.depth_views import DepthViews, Image, sphere_directions
from evalkit.objects.surface import Surface
from evalkit.objects.symmetry import Symmetry

Array = NDArray[np.float64]
SIDE = 200  # pixels of an image, as many as a part has that fills a third of a common depth image
REACH = 2.0  # pixels: 1 % of the diameter, by which outlines may differ
DEPTH = 0.024  # of the bounding radius, by which depth may differ beyond what is seen within REACH
PEAKS = 4.0  # roughnesses by which noise moves depth and outline: one of ten thousand places is farther off
LEAST = 4  # squares of two by two pixels that make a difference: an opening of some 3 % of the diameter
AROUND = 7  # lines of sight beside the principal axes; each is looked along from both ends
TURNS = np.array([0.618, 0.236]) * (2 * np.pi)  # of a revolution: nothing repeats at all of them


class Sight:
    """Views of one surface, and how far they differ once it is turned.

    Args:
        vertices, faces: the mesh that `surface` was made of. Its roughness widens the tolerances by its peaks.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, surface: Surface) -> None:
        about_centroid = (np.asarray(vertices, float) - surface.centroid) / surface.radius
        self._depth = DepthViews(about_centroid, faces, SIDE)
        axes = principal_axes(surface.covariance)[1].T
        directions = np.concatenate([axes, sphere_directions(2 * AROUND)[:AROUND]])
        self._views = list(poses.rotation_between(directions, [0.0, 0.0, 1.0]))
        self._seen: dict[int, tuple[Image, Image, Image]] = {}
        self._order = list(range(len(self._views)))  # the view that last showed a difference comes first
        peaks = PEAKS * surface.roughness
        self._reach, self._tolerance = REACH + peaks * SIDE / 2, np.float32(DEPTH + peaks)

    def excess(self, symmetry: Symmetry) -> float:
        """How many times the least visible difference is seen; not all of it once it is beyond 1."""
        most = 0
        for view in list(self._order):
            for element in telling_elements(symmetry):
                most = max(most, self.difference(element, view))
                if most > LEAST:
                    self._order.remove(view)
                    self._order.insert(0, view)
                    return most / LEAST
        return most / LEAST

    def at_a_glance(self, symmetry: Symmetry, views: int = 1) -> float:
        """The same, of one element and the views that told differences last: cheap, and enough to rank hypotheses."""
        element = telling_elements(symmetry)[0]
        return max(self.difference(element, view) for view in self._order[:views]) / LEAST

    def difference(self, element: Array, view: int) -> int:
        """Squares of 2 x 2 pixels that a turn by `element` (3, 3) leaves unexplained, in any of the view's images."""
        if view not in self._seen:
            self._seen[view] = self._with_limits(self._views[view])
        (before, *limits), (after, *turned_limits) = self._seen[view], self._with_limits(self._views[view] @ element)
        unexplained = [self._beyond(before, *turned_limits), self._beyond(after, *limits)]
        return int(_squares(np.concatenate(unexplained)).max())

    def _with_limits(self, cam_from_obj: Array) -> tuple[Image, Image, Image]:
        """Both images of a view (2, H, W), and the least and the greatest depth within reach of each pixel."""
        images = self._depth.from_both_ends(cam_from_obj)
        return images, within_circle(images, self._reach, np.minimum), within_circle(images, self._reach, np.maximum)

    def _beyond(self, images: Image, nearest: Image, farthest: Image) -> NDArray[np.bool_]:
        return np.asarray((images < nearest - self._tolerance) | (images > farthest + self._tolerance))


def telling_elements(symmetry: Symmetry) -> Array:
    """Elements (n, 3, 3) that show a group to be wrong if any do: they generate it, and turn far.

    What breaks a symmetry is not where any element that generates it puts it. Of a dihedral group a half turn across
    the axis comes first; of the continuous groups there are irregular turns.
    """
    if symmetry.kind == "sphere":
        return poses.random_rotations(np.random.default_rng(0), 3)
    if symmetry.kind == "revolution":
        turns = poses.from_axis_angle(symmetry.axis, TURNS)
        return (symmetry.rotations[::-1, None] @ turns).reshape(-1, 3, 3)
    size, fold = len(symmetry.rotations), symmetry.fold
    if size > 2 * fold:  # a polyhedral group
        return symmetry.rotations[[round(0.62 * size), round(0.85 * size)]]
    far = next(turn for turn in range(round(0.38 * fold), fold + 1) if gcd(turn, fold) == 1)
    return symmetry.rotations[[far] if size == fold else [fold + far, far]]


def within_circle(images: Image, radius: float, least: np.ufunc) -> Image:
    """The least (or with np.maximum the greatest) of each pixel's neighbors: images (..., H, W), radius in pixels."""
    reach = int(radius)
    edges = [(0, 0)] * (images.ndim - 2) + [(reach, reach)] * 2
    padded = np.pad(images, edges, constant_values=np.inf)
    height, width = images.shape[-2:]
    half_widths = [int(np.sqrt(radius**2 - row**2)) for row in range(reach + 1)]  # of the circle, by row
    rows = padded[..., reach : reach + width].copy()
    result, done = None, 0
    for row in range(reach, -1, -1):  # from the circle's narrow ends to its middle
        for offset in range(done + 1, half_widths[row] + 1):
            least(rows, padded[..., reach - offset : reach - offset + width], out=rows)
            least(rows, padded[..., reach + offset : reach + offset + width], out=rows)
        done = half_widths[row]
        above, below = (
            rows[..., reach - row : reach - row + height, :],
            rows[..., reach + row : reach + row + height, :],
        )
        result = least(above, below) if result is None else least(result, least(above, below), out=result)
    return np.asarray(result)


def _squares(masks: NDArray[np.bool_]) -> NDArray[np.int64]:
    """How many squares of 2 x 2 pixels each mask (n, H, W) fills."""
    pairs = masks[:, 1:] & masks[:, :-1]
    return np.asarray((pairs[:, :, 1:] & pairs[:, :, :-1]).sum((1, 2)))
