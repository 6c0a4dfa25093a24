"""Whether a turned surface looks as it did: depth images compared over views.

Distances to the surface do not see an opening: a turned point that lies in a hole is half the hole's width off at
most, however plainly a camera looks through it. So what a camera sees decides too. A pixel of one image is explained
by another where some surface within a small circle about it is as deep; a hole's middle is explained by no solid plate
and a plate by no hole. The circle and the depth's tolerance absorb tessellation and noise; slivers a pixel wide, which
come and go with the sampling where one looks through a gap, do not count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes
from evalkit.objects.depth_views import DepthViews, sphere_directions
from evalkit.objects.surface import Surface
from evalkit.objects.symmetry import Symmetry

Array = NDArray[np.float64]
SIDE = 200  # pixels of an image, as many as a part has that fills a third of a common depth image
REACH = 2.0  # pixels: 1 % of the diameter, by which outlines may differ
DEPTH = 0.024  # of the bounding radius, by which depth may differ beyond what is seen within REACH
LEAST = 4  # squares of two by two pixels that make a difference: an opening of some 3 % of the diameter
AROUND = 14  # views beside those along the principal axes
TURNS = np.array([0.618, 0.236, 0.854, 0.472]) * (2 * np.pi)  # of a revolution: nothing repeats at all of them


class Sight:
    """Views of one surface, and how far they differ once it is turned.

    Args:
        vertices, faces: the mesh that `surface` was made of.
        slack: how many times the tolerances count; a rough surface is off itself even where it is symmetric.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, surface: Surface, slack: float = 1.0) -> None:
        about_centroid = (np.asarray(vertices, float) - surface.centroid) / surface.radius
        self._depth = DepthViews(about_centroid, faces, SIDE)
        axes = principal_axes(surface.covariance)[1].T
        directions = np.concatenate([axes, -axes, sphere_directions(AROUND)])
        self._views = list(poses.rotation_between(directions, [0.0, 0.0, 1.0]))
        self._images: dict[int, NDArray[np.float32]] = {}
        self._order = list(range(len(self._views)))  # the view that last showed a difference comes first
        self._circle, self._tolerance = _circle(REACH * slack), DEPTH * slack

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
        """Squares of 2 x 2 pixels that a turn by `element` (3, 3) leaves unexplained, in either image."""
        if view not in self._images:
            self._images[view] = self._depth.image(self._views[view])
        before, after = self._images[view], self._depth.image(self._views[view] @ element)
        return max(_squares(self._unexplained(before, after)), _squares(self._unexplained(after, before)))

    def _unexplained(self, image: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.bool_]:
        nearest = minimum_filter(other, footprint=self._circle, mode="nearest")
        farthest = maximum_filter(other, footprint=self._circle, mode="nearest")
        return np.asarray((image < nearest - self._tolerance) | (image > farthest + self._tolerance))


def telling_elements(symmetry: Symmetry) -> Array:
    """Elements (n, 3, 3) that show a group to be wrong if any do: they generate it, and some of them turn far.

    Of a finite group at most seven, of a dihedral one a half turn across the axis first; of the continuous ones
    irregular turns.
    """
    if symmetry.kind == "sphere":
        return poses.random_rotations(np.random.default_rng(0), 6)
    if symmetry.kind == "revolution":
        turns = poses.from_axis_angle(symmetry.axis, TURNS)
        return (symmetry.rotations[:, None] @ turns).reshape(-1, 3, 3)
    size = len(symmetry.rotations)
    spread = [round(share * size) for share in (0.62, 0.38, 0.85)]
    return symmetry.rotations[[i for i in dict.fromkeys([*spread, size // 2, 1, 2, 3]) if 0 < i < size]]


def _circle(radius: float) -> NDArray[np.bool_]:
    reach = int(radius)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(x * x + y * y <= radius * radius)


def _squares(mask: NDArray[np.bool_]) -> int:
    """How many squares of 2 x 2 pixels a mask (H, W) fills."""
    return int((mask[1:, 1:] & mask[:-1, 1:] & mask[1:, :-1] & mask[:-1, :-1]).sum())
