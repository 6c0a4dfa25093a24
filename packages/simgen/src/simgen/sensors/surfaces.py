"""What shiny, dark and translucent surfaces do to the light by which a camera measures them.

By the angle of incidence theta, between the surface's normal and the line of sight, and the surface's curvature:

* less comes back from inclined surfaces, the sooner lost the darker or shinier they are: a share of
  1 / (1 + exp((fade - theta) / width)) gives no return;
* a surface that mirrors throws the projector's light straight back where it faces the camera: no return within `glare`;
* what mirrors also shows its surroundings, whose image in a convex mirror of radius r lies r / 2 behind it, in a
  concave one before it; matching sees a mixture. The mirrored share grows with theta (Schlick 1994):
  m + (1 - m) (1 - cos theta)^5. The shift is bounded by `bend_most`, and dies out as surfaces become flat, whose
  mirror images are too far off to be matched;
* light that enters turns back beneath: the surface appears parallel to itself, `penetration` deeper along the
  refracted ray, and so penetration * cos theta_t / cos theta farther along the line of sight, at most three times
  `penetration`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simgen.compiled import compiled
from simgen.sensors.sensor_config import SensorConfig

REFRACTION = 1.5  # of plastics and glass
DEEPEST = 3.0  # times the penetration

Image = NDArray[np.float32]


def lost_by_incidence(sensor: SensorConfig) -> NDArray[np.float64]:
    """Share without a return at 0 .. 90 degrees (91,), of `fade` and `glare`; of one entry where there is neither."""
    if sensor.fade_degrees >= 90 and sensor.glare_degrees <= 0:
        return np.zeros(1)
    angle = np.arange(91.0)
    kept = np.ones(91)
    if sensor.fade_degrees < 90:
        kept /= 1 + np.exp((angle - sensor.fade_degrees) / sensor.fade_width_degrees)
    kept[angle < sensor.glare_degrees] = 0.0
    return 1 - kept


def apparent(disparity: Image, scale: float, focal: tuple[float, float], sensor: SensorConfig) -> Image:
    """Disparity (H, W) of where a surface appears to be; `disparity` itself where it is matte and opaque.

    Args:
        scale: disparity times depth.
        focal: of the camera, in pixels along rows and columns.
    """
    if sensor.mirror_share <= 0 and sensor.penetration <= 0:
        return disparity
    amounts = (sensor.mirror_share, sensor.bend_most, sensor.penetration)
    return np.asarray(_apparent(disparity, scale, *focal, *amounts))


@compiled
def _apparent(disparity, scale, fx, fy, mirror, most, penetration):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    out = disparity.copy()
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            here = disparity[v, u]
            left, right, above, below = (
                disparity[v, u - 1],
                disparity[v, u + 1],
                disparity[v - 1, u],
                disparity[v + 1, u],
            )
            if min(here, left, right, above, below) <= 0:
                continue
            z = scale / here
            # Slopes and bends of 1 / z are those of the surface about the line of sight: planes have no bend
            across, down = fx * (right - left) / (2 * here), fy * (below - above) / (2 * here)
            cosine = 1 / math.sqrt(1 + across * across + down * down)
            shift = 0.0
            if mirror > 0:
                bend = fx * fx * (right - 2 * here + left) + fy * fy * (below - 2 * here + above)
                curvature = -0.5 * cosine**3 * bend / (here * z)  # per meter, convex positive
                image = 0.5 / max(abs(curvature), 1e-9) / most  # mirror images' distance, in the bound
                share = mirror + (1 - mirror) * (1 - cosine) ** 5
                shift += math.copysign(share * most * min(image, 1 / image), curvature)
            if penetration > 0:
                inside = math.sqrt(1 - (1 - cosine * cosine) / REFRACTION**2)
                shift += penetration * min(inside / cosine, DEEPEST)
            out[v, u] = scale / (z + shift)
    return out
