"""Which depth camera: its error model's parameters, where they come from, and how they are given on the command line.

All is said in pixels of disparity, so that a camera's focal length and an object's distance do to the error what they
do in reality: sigma_z = z^2 / (focal * baseline) * sigma_disparity. The pixels are those of the image that is built:
for a sensor that delivers 640 x 480, build 640 x 480.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

IDEAL = "ideal"
MOST_DISPARITY = 0.5  # of the image's width: nearer, what one eye sees the other hardly does


@dataclass(frozen=True)
class SensorConfig:
    """A depth camera that triangulates with a second eye, another camera or a projector, on its right (+x).

    The last six are of the surfaces that it looks at, and off as they stand; :mod:`simgen.sensors.surfaces` says how
    they act.

    Attributes:
        model: name of the preset or file that it came from.
        baseline: meters between the two eyes; negative where the second is on the left.
        noise_px: standard deviation of disparity on a surface that faces the camera.
        noise_per_slope: growth of that with the surface's slope, times (1 + this * tan(slope)).
        quantum_px: step of the measured disparity.
        smooth_missing: share of pixels without a return far from any edge; they come in blobs.
        edge_missing: share without a return right beside a step, falling by e each `edge_reach_px` pixels.
        edge_reach_px: see `edge_missing`.
        step_px: neighbors whose disparity differs by more have a step between them.
        shadow_missing: share without a return where the second eye sees something nearer.
        wrong_patches: area of patches matched to another place's disparity, over the area close to steps.
        steepest_degrees: steeper surfaces give no return.
        noise_blur: lengths over which noise is correlated, in those of :mod:`simgen.sensors.random_fields`; 0: white.
        depth_step: meters a step of the depth that the camera delivers; 0: finer than what is stored.
        fade_degrees: angle of incidence at which half of the returns are lost; 90: none.
        fade_width_degrees: over how many degrees that comes about.
        glare_degrees: nearer to facing the camera, a surface throws the light back and gives no return.
        mirror_share: of the light that a surface reflects as a mirror does, facing the camera; 0: it is matte.
        bend_most: meters by which mirrored light moves depth at most.
        penetration: meters that light goes into a surface before it turns back.
    """

    model: str
    baseline: float
    noise_px: float
    noise_per_slope: float
    quantum_px: float
    smooth_missing: float
    edge_missing: float
    edge_reach_px: float
    step_px: float
    shadow_missing: float
    wrong_patches: float
    steepest_degrees: float
    noise_blur: float = 1.0
    depth_step: float = 0.0
    fade_degrees: float = 90.0
    fade_width_degrees: float = 6.0
    glare_degrees: float = 0.0
    mirror_share: float = 0.0
    bend_most: float = 0.005
    penetration: float = 0.0

    def __post_init__(self) -> None:
        for name, least, most in (
            ("noise_px", 0.0, 10.0),
            ("noise_per_slope", 0.0, 10.0),
            ("quantum_px", 1e-4, 10.0),
            ("smooth_missing", 0.0, 1.0),
            ("edge_missing", 0.0, 1.0),
            ("edge_reach_px", 0.1, 100.0),
            ("step_px", 1e-3, 100.0),
            ("shadow_missing", 0.0, 1.0),
            ("wrong_patches", 0.0, 1.0),
            ("steepest_degrees", 1.0, 90.0),
            ("noise_blur", 0.0, 5.0),
            ("depth_step", 0.0, 0.1),
            ("fade_degrees", 1.0, 90.0),
            ("fade_width_degrees", 0.1, 45.0),
            ("glare_degrees", 0.0, 60.0),
            ("mirror_share", 0.0, 1.0),
            ("bend_most", 1e-6, 0.1),
            ("penetration", 0.0, 0.05),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= most):
                raise InputError(f"--sensor {self.model}: {name} {value:g} must be {least:g} to {most:g}.")
        if not 1e-4 <= abs(self.baseline) <= 10.0:
            raise InputError(f"--sensor {self.model}: baseline {self.baseline:g} must be 0.0001 to 10, to either side.")

    def sigma(self, camera: Camera, distance: float) -> float:
        """Standard deviation in meters of the depth of a surface that faces the camera at `distance` meters."""
        return self.noise_px * distance**2 / (camera.fx * abs(self.baseline))

    def describe(self, camera: Camera, nearest: float, farthest: float) -> str:
        """One line: the noise that the parameters come to with this camera, and all of them."""
        near, far = (1e3 * self.sigma(camera, distance) for distance in (nearest, farthest))
        values = ", ".join(f"{f.name} {getattr(self, f.name):g}" for f in fields(self) if f.name != "model")
        return (
            f"Sensor {self.model}: depth noise of {near:.2g} mm at {nearest:.2g} m to {far:.2g} mm at {farthest:.2g} m "
            f"({values})."
        )

    def require_range(self, camera: Camera, nearest: float) -> None:
        """Refuse a baseline too long for the distance.

        Raises:
            InputError: at `nearest` meters the two eyes see different things.
        """
        disparity, most = camera.fx * abs(self.baseline) / nearest, MOST_DISPARITY * camera.width
        if disparity > most:
            fitting = float(f"{0.5 * most * nearest / camera.fx:.1g}")
            raise InputError(
                f"--sensor {self.model}: from {nearest:.2g} m its two eyes, {self.baseline:g} m apart, would see "
                f"different places; give a shorter baseline, as in --sensor {self.model},baseline={fitting:g}."
            )


def stereo() -> SensorConfig:
    """Two cameras with block matching, fitted to Siléane's published noisy bunny, a simulated block-matching camera.

    Its errors at 1.3 m are in docs/own-camera.md, and benchmarks/speed/bench_sensor.py prints ours beside them. The
    baseline is a compact camera's, a choice; so are the disparity's step (1/32 px, usual for such cameras), the jump
    that makes a step and the slope that still returns.
    """
    return SensorConfig(
        model="stereo",
        baseline=0.06,
        noise_px=0.065,
        noise_per_slope=0.33,
        quantum_px=1 / 32,
        smooth_missing=0.028,
        edge_missing=0.45,
        edge_reach_px=3.0,
        step_px=1.0,
        shadow_missing=0.74,
        wrong_patches=0.38,
        steepest_degrees=80.0,
    )


def kinect() -> SensorConfig:
    """Structured light as in the first Kinect.

    Khoshelham & Elberink 2012: baseline 7.5 cm, disparity in steps of 1/8 px, a random error of half a step (1.4 mm at
    1 m, 4 cm at 5 m, growing with the square of the distance). Nguyen et al. 2012: axial noise grows with the slope,
    and edges are ragged by about a pixel, here by what is missing beside them. Where the projector's pattern does not
    fall nothing returns. Next to nothing is missing on smooth surface: 0 to 0.3 % in a frame of the ICVL dataset, whose
    camera is of this kind. The share missing beside steps is an assumption.
    """
    return SensorConfig(
        model="kinect",
        baseline=0.075,
        noise_px=1 / 16,
        noise_per_slope=0.3,
        quantum_px=1 / 8,
        smooth_missing=0.003,
        edge_missing=0.25,
        edge_reach_px=1.5,
        step_px=0.5,
        shadow_missing=1.0,
        wrong_patches=0.05,
        steepest_degrees=80.0,
    )


SENSORS: dict[str, Callable[[], SensorConfig]] = {"stereo": stereo, "kinect": kinect}
