"""Piles by each physics engine, side by side: what they cost, how still and how deep in each other they lie.

    python benchmarks/speed/bench_physics.py [--objects bunny,candlestick,gear,brick] [--instances 10-20] [--scenes 12]
                                       [--physics pybullet,rapier]

CPU seconds of one core, drops that were thrown away included. The engines take turns scene by scene, so that other work
on the machine slows both. Visibility is that of the labels, from two cameras a scene; tilt is that of the object's z
axis from the vertical.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from pile_quality import below_floor, hulls_of, motion_afterwards, penetrations
from simgen.commands.parsing import parse_instances
from simgen.objects.prepare import prepare_object
from simgen.presets import PHYSICS, default, default_camera
from simgen.scenes.job import Job
from simgen.scenes.plan import plan
from simgen.scenes.render import SceneRenderer
from simgen.scenes.simulate import make_scene

Array = NDArray[np.float64]
VIEWS = 2
DECILES = range(10, 100, 20)


@dataclass
class Piles:
    """What one engine made of the scenes: CPU seconds and drops a scene, and per instance or pair, in millimeters."""

    seconds: list[float] = field(default_factory=list)
    drops: list[int] = field(default_factory=list)
    failed: int = 0
    moved: list[Array] = field(default_factory=list)
    overlap: list[Array] = field(default_factory=list)
    in_floor: list[Array] = field(default_factory=list)
    visibility: list[Array] = field(default_factory=list)
    tilt: list[Array] = field(default_factory=list)
    height: list[float] = field(default_factory=list)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", default="bunny,candlestick,gear,brick")
    parser.add_argument("--instances", default="10-20")
    parser.add_argument("--physics", default=",".join(PHYSICS))
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    for source in options.objects.split(","):
        jobs = {name: job_of(source, options, name) for name in options.physics.split(",")}
        piles = {name: Piles() for name in jobs}
        for scene in range(options.scenes):
            for name, job in jobs.items():
                measure_scene(job, scene, piles[name])
        print(f"{source}, {options.instances} instances, {options.scenes} scenes")
        for name, found in piles.items():
            report(name, found)


def job_of(source: str, options: argparse.Namespace, engine: str) -> Job:
    prepared = prepare_object(source)
    least, most = parse_instances(options.instances)
    config = replace(
        default(), scenes=options.scenes, views=VIEWS, seed=options.seed, instances_min=least, instances_max=most,
        camera=default_camera(320, 240), physics=PHYSICS[engine](),
    )  # fmt: skip
    return plan(config, prepared.model, prepared.convex_parts)


def measure_scene(job: Job, number: int, piles: Piles) -> None:
    started = time.process_time()
    try:
        scene, drops = make_scene(job, number)
    except InputError:
        piles.failed += 1
        return
    finally:
        piles.seconds.append(time.process_time() - started)
    hulls, pile = hulls_of(job), scene.world_from_obj
    piles.drops.append(drops)
    piles.moved.append(1e3 * motion_afterwards(job, number, pile, job.config.physics))
    piles.overlap.append(1e3 * penetrations(hulls, pile))
    piles.in_floor.append(1e3 * below_floor(hulls, pile))
    piles.visibility += [view.instances.visibility("geometric") for view in SceneRenderer(job).views(scene)]
    piles.tilt.append(np.degrees(np.arccos(np.clip(pile[:, 2, 2], -1, 1))))
    piles.height.append(1e3 * float(job.model.centers(pile)[:, 2].mean()))


def report(name: str, piles: Piles) -> None:
    done = len(piles.drops)
    most = [float(moved.max()) for moved in piles.moved]
    overlap, floor = np.concatenate(piles.overlap), np.concatenate(piles.in_floor)
    print(
        f"  {name:<9}{np.mean(piles.seconds):7.3f} CPU s a scene, {sum(piles.drops) / max(done, 1):.2f} drops; "
        f"{piles.failed} never at rest; centers {np.mean(piles.height):.1f} mm high"
    )
    print(
        f"    motion in the next 2 s, mm: farthest of a scene {np.median(most):.3f} median, {max(most):.3f} worst; "
        f"in each other {np.percentile(overlap, 99):.3f} p99, {overlap.max():.3f} worst; in the floor {floor.max():.3f}"
    )
    visibility, tilt = np.concatenate(piles.visibility), np.concatenate(piles.tilt)
    shares = " ".join(f"{value:.2f}" for value in np.percentile(visibility, DECILES))
    angles = " ".join(f"{value:.0f}" for value in np.percentile(tilt, DECILES))
    print(f"    visibility {visibility.mean():.3f}, at 10 30 50 70 90 % {shares}; tilt in degrees {angles}")


if __name__ == "__main__":
    main()
