"""How the cost of a pile grows with the number of its instances."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from simgen.objects.prepare import PreparedObject
from simgen.presets import PHYSICS, default
from simgen.scenes.plan import plan
from simgen.scenes.simulate import simulate_poses


def report_growth(prepared: PreparedObject, counts: list[int], scenes: int, seed: int, engine: str) -> None:
    """Print CPU seconds a scene, drops thrown away included, for each count, and the power law through them."""
    print(f"{prepared.model.name}, {scenes} scenes each, {engine}")
    seconds = [_measure(prepared, count, scenes, seed, engine) for count in counts]
    if len(counts) > 1:
        power = np.polyfit(np.log(counts), np.log(seconds), 1)[0]
        steps = np.log(seconds[-1] / seconds[0]) / np.log(counts[-1] / counts[0])
        print(f"  grows as instances to the power of {power:.2f}; from the fewest to the most, {steps:.2f}")


def _measure(prepared: PreparedObject, count: int, scenes: int, seed: int, engine: str) -> float:
    config = replace(
        default(), scenes=scenes, seed=seed, instances_min=count, instances_max=count, physics=PHYSICS[engine]()
    )
    job = plan(config, prepared.model, prepared.convex_parts)
    started = time.process_time()
    drops = [simulate_poses(job, scene)[1] for scene in range(scenes)]
    seconds = (time.process_time() - started) / scenes
    print(f"  {count:>5} instances: {seconds:7.3f} CPU s a scene, {sum(drops) / scenes:.2f} drops each", flush=True)
    return seconds
