"""The sensor whose errors, drawn on the surfaces that a camera saw, have the statistics of the camera's images.

Estimates from single images are biased: a local fit takes part of the noise for shape, a hole hides where its edge is.
The twin, the fitted sensor's images of the same surfaces, is measured in the same way, and so has the same biases:
parameters are moved until both agree (indirect inference, Gouriéroux, Monfort & Renault 1993).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgen.sensor_fit.frames import FitFrames
from simgen.sensor_fit.quantization import depth_step, inverse_step
from simgen.sensor_fit.seen_surface import STEP, Image, Surface, surfaces_of
from simgen.sensor_fit.statistics import Statistics, statistics_of
from simgen.sensors.sensor import measure, sensor_generator
from simgen.sensors.sensor_config import SensorConfig

log = logging.getLogger(__name__)
USUAL_BASELINE = 0.06  # meters, where the images do not tell
BASELINES = (0.02, 0.035, 0.05, 0.065, 0.085, 0.11)  # meters
BLURS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
ROUNDS, LAST_ROUNDS = 3, 5
ENOUGH = 300  # pixels that a figure rests on
NOISE_FRAMES = 3  # frames that the noise is fitted on
MIDDLES = np.tan(np.radians([20.0, 38.0, 52.0, 66.0]))  # of the groups of slope, as their pixels lie
FIT_SEED, TWIN_SEED = 1, 2
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FittedSensor:
    """A sensor, the figures of the images that it was fitted to, and those of its own images of the same surfaces.

    `heap`: those of its images of simulated heaps, where the part is known.
    """

    sensor: SensorConfig
    real: Statistics
    twin: Statistics
    surfaces: tuple[Surface, ...]
    twins: tuple[Image, ...]
    heap: Statistics | None = None


def fit_sensor(frames: FitFrames, baseline: float | None = None, name: str = "fitted") -> FittedSensor:
    """Fit a sensor.

    Args:
        baseline: meters between the eyes, negative where the second is on the left; found from the shadows if None.
        name: what the sensor is called.
    """
    surfaces = surfaces_of(frames.depths, frames.camera, frames.static)
    real = statistics_of(frames.depths, frames.camera, frames.static)
    start = _start(frames, surfaces, baseline, name)
    some = replace(frames, names=frames.names[:NOISE_FRAMES], depths=frames.depths[:NOISE_FRAMES])
    noisy = _with_noise(start, some, surfaces[:NOISE_FRAMES])
    side = -1.0 if _sum(real.beside[1]) > _sum(real.beside[0]) else 1.0
    if baseline is None and real.beside_count.sum() < ENOUGH:
        baseline = USUAL_BASELINE  # without steps there are no shadows
    tried = [side * length for length in BASELINES] if baseline is None else [baseline]
    fits = [_with_losses(_on_baseline(noisy, length), real, frames, surfaces, ROUNDS) for length in tried]
    for fit, twin in fits:
        log.info("baseline %g m: shares missing beside steps are off by %.3f", fit.baseline, _mismatch(real, twin))
    best = min(fits, key=lambda fit: _mismatch(real, fit[1]))[0]
    best = _on_baseline(best, _between(tried, [_mismatch(real, twin) for _, twin in fits]))
    best = _with_losses(best, real, frames, surfaces, LAST_ROUNDS, noise=True)[0]
    twins = twin_images(frames, surfaces, best, TWIN_SEED)
    return FittedSensor(best, real, statistics_of(twins, frames.camera, frames.static), tuple(surfaces), tuple(twins))


def twin_images(frames: FitFrames, surfaces: Sequence[Surface], sensor: SensorConfig, seed: int) -> list[Image]:
    """What `sensor` makes of the surfaces, missing where the images do not show them."""
    made = []
    for number, surface in enumerate(surfaces):
        depth = (np.float32(frames.camera.fx) / surface.q).astype(np.float32)
        drawn = measure(depth, frames.camera, sensor, sensor_generator(seed, number, 0))
        drawn[surface.away] = 0
        made.append(drawn)
    return made


def _start(frames: FitFrames, surfaces: Sequence[Surface], baseline: float | None, name: str) -> SensorConfig:
    """A sensor without errors but the steps in which the images' depth comes."""
    length = USUAL_BASELINE if baseline is None else baseline
    returned = np.concatenate([depth[depth > 0] for depth in frames.depths]).astype(float)
    step = depth_step(returned)
    quantum = inverse_step(frames.camera.fx / returned, step, frames.camera.fx)
    z = float(np.median(returned))
    unseen = 0.02 * step * frames.camera.fx / z**2  # so fine that it does not matter
    return SensorConfig(
        model=name,
        baseline=length,
        noise_px=0.0,
        noise_per_slope=0.0,
        quantum_px=max((quantum or unseen) * abs(length), 1e-4),
        smooth_missing=0.0,
        edge_missing=0.0,
        edge_reach_px=1.5,
        step_px=STEP * abs(length) / z,
        shadow_missing=0.0,
        wrong_patches=0.0,
        steepest_degrees=89.0,
        depth_step=step,
    )


def _on_baseline(sensor: SensorConfig, length: float) -> SensorConfig:
    """The same errors of depth by a sensor of another baseline."""
    factor = abs(length / sensor.baseline)
    return replace(
        sensor,
        baseline=length,
        noise_px=sensor.noise_px * factor,
        quantum_px=max(sensor.quantum_px * factor, 1e-4),
        step_px=sensor.step_px * factor,
    )


def _with_noise(sensor: SensorConfig, frames: FitFrames, surfaces: Sequence[Surface]) -> SensorConfig:
    """The sensor with the noise, its growth with slope and its correlation that the images have."""

    def figures(tried: SensorConfig) -> Statistics:
        images = twin_images(frames, surfaces, tried, FIT_SEED)
        return statistics_of(images, frames.camera, frames.static)

    real = statistics_of(frames.depths, frames.camera, frames.static)
    main = int(np.argmax(real.noise_count))  # the slope that most pixels have
    if not np.isfinite(real.noise[main]):
        return sensor
    none = figures(sensor)
    trial = max(float(real.noise[main]), 1e-6)
    best, least = sensor, math.inf
    for blur in BLURS:
        some = figures(replace(sensor, noise_px=trial * abs(sensor.baseline), noise_blur=blur))
        gain = np.maximum(some.noise**2 - none.noise**2, 1e-12) / trial**2
        needed = np.sqrt(np.maximum(real.noise**2 - none.noise**2, 0) / gain)
        noise, growth = _growing(needed, real.noise_count)
        share = (noise / trial) ** 2  # of the trial's variance; covariances add up as variances do
        before, after = none.noise[main] ** 2 * none.correlation, some.noise[main] ** 2 * some.correlation
        variance = max(none.noise[main] ** 2 + share * (some.noise[main] ** 2 - none.noise[main] ** 2), 1e-12)
        off = float((((before + share * (after - before)) / variance - real.correlation) ** 2).sum())
        if off < least:
            least = off
            best = replace(
                sensor,
                noise_px=min(noise * abs(sensor.baseline), 10.0),
                noise_per_slope=min(growth, 10.0),
                noise_blur=blur,
            )
    return best


def _growing(noise: Array, counts: Array) -> tuple[float, float]:
    """`n` and `k` of n * (1 + k tan(slope)) that are nearest to the noise by slope (4,)."""
    used = (counts >= ENOUGH) & np.isfinite(noise)
    if not used.any():
        return float(np.nan_to_num(noise[np.argmax(counts)])), 0.0
    tangents = MIDDLES[used]
    weight = np.sqrt(np.maximum(counts[used], 1.0))
    design = np.column_stack([np.ones_like(tangents), tangents]) * weight[:, None]
    if used.sum() == 1:
        return float(noise[used][0]), 0.0
    base, slope = np.linalg.lstsq(design, noise[used] * weight, rcond=None)[0]
    if base <= 0 or slope < 0:
        return float(np.average(noise[used], weights=weight)), 0.0
    return float(base), float(slope / base)


def _with_losses(
    sensor: SensorConfig,
    real: Statistics,
    frames: FitFrames,
    surfaces: Sequence[Surface],
    rounds: int,
    noise: bool = False,
) -> tuple[SensorConfig, Statistics]:
    """The sensor whose missing returns and flying pixels are the images', and the figures of its last twin."""
    if sensor.edge_missing == 0:
        sensor = replace(
            sensor,
            smooth_missing=_share(real.missing[0]),
            edge_missing=_share(real.beside[1, 0]),
            shadow_missing=_share(real.beside[0, 0]),
            wrong_patches=_share(real.flying),
        )
    for _ in range(rounds):
        twin = statistics_of(twin_images(frames, surfaces, sensor, FIT_SEED), frames.camera, frames.static)
        sensor = _nearer(sensor, real, twin, noise)
    twin = statistics_of(twin_images(frames, surfaces, sensor, FIT_SEED), frames.camera, frames.static)
    return sensor, twin


def _nearer(sensor: SensorConfig, real: Statistics, twin: Statistics, noise: bool) -> SensorConfig:
    """Each parameter moved by what its own figure is off."""
    shadowed, plain = (0, 1) if sensor.baseline > 0 else (1, 0)
    changes = {
        "smooth_missing": _share(sensor.smooth_missing + real.missing[0] - twin.missing[0]),
        "edge_missing": _scaled(sensor.edge_missing, _sum(real.beside[plain, :2]), _sum(twin.beside[plain, :2])),
        "edge_reach_px": float(
            np.clip(
                _scaled(sensor.edge_reach_px, _sum(real.beside[plain, 3:]), _sum(twin.beside[plain, 3:]), 0.7), 0.3, 12
            )
        ),
        "shadow_missing": _share(
            sensor.shadow_missing + 0.7 * (_mean(real.beside[shadowed, :3]) - _mean(twin.beside[shadowed, :3]))
        ),
        "wrong_patches": _scaled(sensor.wrong_patches, real.flying, twin.flying),
    }
    steep = (real.missing_count[3] >= ENOUGH) and (real.missing[3] > real.missing[0] + 0.02 or sensor.fade_degrees < 90)
    if steep:
        off = twin.missing[3] - real.missing[3]
        changes["fade_degrees"] = float(np.clip(min(sensor.fade_degrees, 86.0) + 25.0 * off, 45.0, 90.0))
    main = int(np.argmax(real.noise_count))
    if noise and np.isfinite(real.noise[main] / max(twin.noise[main], 1e-12)):
        changes |= _noise_nearer(sensor, real, twin, main)
    return replace(sensor, **changes)  # type: ignore[arg-type]


def _noise_nearer(sensor: SensorConfig, real: Statistics, twin: Statistics, main: int) -> dict[str, float]:
    """Noise, by the slope that most pixels have, and its growth with slope, moved by what the figures are off."""
    facing = float(np.clip(real.noise[main] / max(twin.noise[main], 1e-12), 0.5, 2.0))
    changes = {"noise_px": min(sensor.noise_px * facing, 10.0)}
    steep = np.where((real.noise_count >= ENOUGH) & (twin.noise_count >= ENOUGH), real.noise_count, 0.0) * (MIDDLES > 1)
    if steep.any():
        wanted, had = (float(np.nansum(steep * figures.noise)) for figures in (real, twin))
        tangent = float((steep * MIDDLES).sum() / steep.sum())
        grown = (1 + sensor.noise_per_slope * tangent) * float(np.clip(wanted / had, 0.5, 2.0)) ** 1.5 / facing
        changes["noise_per_slope"] = float(np.clip((grown - 1) / tangent, 0.0, 10.0))
    return changes


def _between(lengths: Sequence[float], mismatches: Sequence[float]) -> float:
    """The baseline where a parabola through the best of `lengths` and its neighbors is lowest; the best at the ends."""
    best = int(np.argmin(mismatches))
    if not 0 < best < len(lengths) - 1:
        return lengths[best]
    part = slice(best - 1, best + 2)
    a, b, _ = np.polyfit(np.log(np.abs(lengths[part])), np.square(mismatches[part]), 2)
    return math.copysign(math.exp(-b / (2 * a)), lengths[best]) if a > 0 else lengths[best]


def _mismatch(real: Statistics, twin: Statistics) -> float:
    """How far off the shares missing beside steps are, weighted by pixels."""
    weight = np.where(real.beside_count >= ENOUGH / 3, real.beside_count, 0.0)
    return math.sqrt(float(np.nansum(weight * (real.beside - twin.beside) ** 2)) / max(float(weight.sum()), 1.0))


def _scaled(value: float, wanted: float, had: float, power: float = 0.8) -> float:
    """A parameter times what its figure lacks, within a share's bounds where it is one."""
    ratio = float(np.clip((wanted + 1e-3) / (had + 1e-3), 0.4, 2.5)) ** power
    return float(max(value, 1e-3) * ratio) if power != 0.8 else _share(max(value, 1e-3) * ratio)


def _share(value: float) -> float:
    return float(np.clip(np.nan_to_num(value), 0.0, 1.0))


def _sum(values: Array) -> float:
    return float(np.nansum(values))


def _mean(values: Array) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else 0.0
