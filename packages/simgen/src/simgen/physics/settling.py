"""Instances fall until they rest; one that leaves the bin, or creeps on and on, is put back on top of the heap."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from simgen.physics.world import World

Array = NDArray[np.float64]
LOOKS_PER_WINDOW = 5
SUNK = 0.01  # object diameters; a thin instance may be driven that deep into the floor, and stay there
CLEARANCE = 1.05  # radii between the center of an instance that is put back and what it may land on
DRAWS = 8  # of where to put an instance back, the lowest of which counts: hollows fill before peaks grow


def settle(world: World, rng: np.random.Generator) -> bool:
    """Simulate until no instance has moved throughout the quiet window.

    Rest is judged per instance: one that rests among resting ones is held still while the others settle. An instance
    that leaves the bin, sinks into its floor, or has not come to rest in time, is dropped again from above the heap;
    the others stay where they are. `rng` says from where.

    Returns:
        False if instances would have to be put back more often than there are instances: the bin holds no such heap.
    """
    config = world.config
    world.hold(np.zeros(len(world.marks()), bool))
    interval = config.quiet_window / LOOKS_PER_WINDOW
    recent = deque([world.marks()], maxlen=LOOKS_PER_WINDOW)
    returns = len(recent[0])
    now, landed = 0.0, _fall_seconds(world, recent[0][:, 0, 2].max())
    late = landed + config.max_seconds
    while True:
        (world.fall if now < landed else world.rest)(interval)
        now += interval
        marks = world.marks()
        restless = np.abs(np.stack(recent) - marks).max((0, 2, 3)) >= config.quiet_motion
        if len(recent) < LOOKS_PER_WINDOW:
            restless[:] = True
        at_rest = not restless.any()
        misplaced = _is_away(world, marks[:, 0]) | (restless & (now > late))
        if at_rest:
            misplaced |= world.lowest() < -SUNK * config.simulated_diameter
        if misplaced.any():
            returns -= int(misplaced.sum())
            if returns < 0:
                return False
            height = _put_back(world, np.flatnonzero(misplaced), marks[:, 0], rng)
            marks = world.marks()
            landed = now + _fall_seconds(world, height)
            late = landed + config.max_seconds
        elif at_rest:
            return True
        else:
            world.hold(_undisturbed(world, restless))
        recent.append(marks)


def _undisturbed(world: World, restless: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which instances (n,) are at rest and touch none that is not."""
    if restless.all():
        return ~restless
    disturbed, pairs = restless.copy(), world.touching()
    for one, other in (pairs.T, pairs.T[::-1]):
        disturbed[one[restless[other]]] = True
    return ~disturbed


def _fall_seconds(world: World, height: float) -> float:
    """How long an instance falls whose center is at that height if nothing is in its way."""
    return float(np.sqrt(2 * max(height, 0.0) / world.config.gravity))


def _is_away(world: World, centers: Array) -> NDArray[np.bool_]:
    """Which of the centers (n, 3) are outside the bin, or nowhere."""
    inside = (np.abs(centers[:, :2]) <= world.size.reach).all(1) & (centers[:, 2] > -world.config.quiet_motion)
    return np.asarray(~inside)


def _put_back(world: World, indices: NDArray[np.int64], centers: Array, rng: np.random.Generator) -> float:
    """Start the instances again from above the others, at random turns; returns the greatest height."""
    radius = world.body.radius
    half = np.maximum(np.array([world.size.width, world.size.depth]) / 2 - radius, 0.0)
    there = np.delete(centers, indices, 0)
    for index in indices:
        ground = rng.uniform(-1, 1, (DRAWS, 2)) * half
        near = (np.abs(ground[:, None] - there[:, :2]) < 2 * radius).all(-1)
        heights = np.where(near, there[:, 2] + 2 * radius, radius).max(1, initial=radius) + (CLEARANCE - 1) * radius
        lowest = heights.argmin()
        start = np.append(ground[lowest], heights[lowest])
        world.put(int(index), start, random_quaternions(rng, 1)[0])
        there = np.vstack([there, start])
    return float(there[-len(indices) :, 2].max())


def random_quaternions(rng: np.random.Generator, count: int) -> Array:
    """Unit quaternions xyzw (count, 4) of rotations that are uniform over SO(3)."""
    drawn = rng.standard_normal((count, 4))
    return np.asarray(drawn / np.sqrt((drawn * drawn).sum(1, keepdims=True)))
