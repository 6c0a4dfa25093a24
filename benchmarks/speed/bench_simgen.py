"""How fast simgen builds, stage by stage, beside others on the same frames, and how good its piles are.

    python benchmarks/speed/bench_simgen.py [--object bunny] [--faces 5000] [--scenes 8] [--views 17] [--peer-frames 3]
    python benchmarks/speed/bench_simgen.py --instances 15,40,80,150 [--physics rapier]

Times are CPU times of one core, the least of `--repeats` measurements of each scene or frame, so that other work on the
machine does not count. A worker process of its own does what a worker of `simgen build` does, and tells its memory.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import trimesh
from numpy.typing import NDArray

from crowd_growth import report_growth
from evalkit.datasets.scene import Scene, View
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.objects.model import ObjectModel
from peer_renderers import least_seconds, renderer_of, report_peers
from pile_quality import below_floor, hulls_of, motion_afterwards, penetrations
from simgen.objects.prepare import prepare_object
from simgen.physics.bin_shape import bin_mesh
from simgen.presets import PHYSICS, default
from simgen.rendering.labels import label_instances, quantized
from simgen.rendering.renderers import DepthRenderer
from simgen.scenes.job import Job
from simgen.scenes.plan import plan
from simgen.scenes.simulate import make_scene
from simgen.sensors.sensor import measure, sensor_generator
from simgen.sensors.sensor_config import SensorConfig, stereo

SCENES, VIEWS, CORES = 2000, 17, 2  # what is projected to: the paper's set
COPIED_MB = 64
NAMES = ("median", "p95", "p99", "max")
Result = TypeVar("Result")
Array = NDArray[np.float64]


@dataclass
class Measured:
    """What a worker measured.

    Attributes:
        seconds: of each stage, CPU time: of physics a scene, of the others a frame.
        silhouettes: pixels of all silhouettes of a frame, on average.
        stored: bytes of a frame in the shard.
        peak_mb: of the process's memory, after the first scene and after all.
    """

    scenes: list[Scene] = field(default_factory=list)
    attempts: list[int] = field(default_factory=list)
    seconds: dict[str, list[float]] = field(default_factory=dict)
    visibility: list[float] = field(default_factory=list)
    silhouettes: float = 0.0
    stored: float = 0.0
    peak_mb: list[float] = field(default_factory=list)

    def timed(self, stage: str, repeats: int, work: Callable[..., Result], *arguments: Any) -> Result:
        least = float("inf")
        for _ in range(repeats):
            started = time.process_time()
            result = work(*arguments)
            least = min(least, time.process_time() - started)
        self.seconds.setdefault(stage, []).append(least)
        return result

    def mean(self, stage: str) -> float:
        return float(np.mean(self.seconds[stage]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="bunny", help="as of simgen build (bunny)")
    parser.add_argument("--faces", type=int, default=5000, help="to which the drawn mesh is remade (5,000)")
    parser.add_argument("--scenes", type=int, default=8, help="(8)")
    parser.add_argument("--views", type=int, default=VIEWS, help="frames a scene (17)")
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--repeats", type=int, default=2, help="of which the fastest counts (2)")
    parser.add_argument("--peer-frames", type=int, default=3, help="drawn by the others as well (3; 0: none)")
    parser.add_argument("--instances", help="only physics, for each of these numbers of instances: 15,40,80,150")
    parser.add_argument("--physics", default="pybullet", choices=list(PHYSICS))
    options = parser.parse_args()
    if options.instances:
        counts = [int(count) for count in options.instances.split(",")]
        report_growth(prepare_object(options.object), counts, options.scenes, options.seed, options.physics)
        return
    job = job_of(options.object, options.faces, options.scenes, options.views, options.seed, options.physics)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as executor:
        measured = executor.submit(measure_worker, job, options.repeats).result()
    report_stages(job, measured)
    report_limit(job, measured)
    report_peers(job, measured.scenes[0], options.peer_frames)
    report_piles(job, measured)


def job_of(source: str, faces: int, scenes: int, views: int, seed: int, engine: str) -> Job:
    """The paper's set of that object: the same piles, drawn with about that many faces."""
    prepared = prepare_object(source)
    config = replace(default(), scenes=scenes, views=views, seed=seed, physics=PHYSICS[engine]())
    job = plan(config, prepared.model, prepared.convex_parts)
    vertices, triangles = remade(prepared.model, faces)
    return replace(job, model=replace(prepared.model, vertices=vertices, faces=triangles))


def remade(model: ObjectModel, faces: int) -> tuple[Array, NDArray[np.int32]]:
    """The model's mesh, cut in quarters until it has enough faces, and simplified to `faces`."""
    assert model.vertices is not None and model.faces is not None
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    while len(mesh.faces) < faces:
        mesh = mesh.subdivide()
    if len(mesh.faces) > faces:
        mesh = mesh.simplify_quadric_decimation(face_count=faces)
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)


def measure_worker(job: Job, repeats: int) -> Measured:
    """Build all scenes of the job as one shard, stage by stage."""
    measured, renderer, sensor = Measured(), renderer_of(job), stereo()
    renderer.render(np.eye(4)[None], np.eye(4))  # compiles
    measure(np.ones((job.config.camera.height, job.config.camera.width), np.float32), *_sensor_of(job, sensor, 0, 0))
    pixels: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shard.h5"
        writer = ShardWriter(path, job.header, job.config.scenes * job.config.views)
        with writer:
            for number in range(job.config.scenes):
                scene, attempts = measured.timed("physics", repeats, make_scene, job, number)
                measured.scenes.append(scene)
                measured.attempts.append(attempts)
                renderer.set_background(*bin_mesh(job.scene_bin(number)))
                for view in range(job.config.views):
                    frame = measure_frame(job, measured, renderer, scene, view, repeats)
                    pixels.append(float(frame.instances.pixels_full.sum()))
                    measured.timed("write", 1, writer.append, frame)
                    measured.timed("stereo sensor", 1, measure, frame.depth, *_sensor_of(job, sensor, number, view))
                measured.peak_mb.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
            started = time.process_time()
        measured.seconds["seal"] = [(time.process_time() - started) / writer.frames]
        measured.stored = path.stat().st_size / writer.frames
    measured.silhouettes = float(np.mean(pixels))
    return measured


def measure_frame(job: Job, measured: Measured, renderer: DepthRenderer, scene: Scene, view: int, repeats: int) -> View:
    """What `SceneRenderer.views` does, taken apart."""
    cam_from_world, camera = scene.cam_from_world[view], job.config.camera
    cam_from_obj = cam_from_world @ scene.world_from_obj
    rendering = measured.timed("raster", repeats, renderer.render, cam_from_obj, cam_from_world)
    depth = measured.timed("quantize", repeats, quantized, rendering.depth, job.depth_unit)
    labels = measured.timed("labels", repeats, label_instances, rendering, depth, cam_from_obj, job.model, camera)
    measured.visibility.extend(labels.visibility_geometric.tolist())
    return View(camera, depth, job.depth_unit, rendering.instance_id, cam_from_world, labels, scene.index, view)


def _sensor_of(job: Job, sensor: SensorConfig, scene: int, view: int) -> tuple[Any, SensorConfig, np.random.Generator]:
    return job.config.camera, sensor, sensor_generator(job.config.seed, scene, view)


def report_stages(job: Job, measured: Measured) -> None:
    camera, views = job.config.camera, job.config.views
    print(
        f"{job.model.name}, {len(job.model.mesh[1]):,} faces; {job.config.scenes} scenes x {views} views of "
        f"{camera.width} x {camera.height}, {np.mean([len(s.world_from_obj) for s in measured.scenes]):.1f} instances"
    )
    stages = {
        "physics": measured.mean("physics") / views,
        "raster": measured.mean("raster"),
        "labels": measured.mean("quantize") + measured.mean("labels"),
        "write": measured.mean("write") + measured.mean("seal"),
    }
    whole = sum(stages.values())
    for name, seconds in stages.items():
        print(f"  {name:<28}{1e3 * seconds:8.2f} ms a frame {seconds / whole:5.0%}")
    print(f"  {'in all':<28}{1e3 * whole:8.2f} ms a frame; {measured.stored / 1e3:.0f} kB, with checksums")
    sensor = measured.mean("stereo sensor")
    print(f"  {'--sensor stereo, on top':<28}{1e3 * sensor:8.2f} ms a frame")
    print(
        f"physics: {1e3 * measured.mean('physics'):.0f} ms a scene, {np.mean(measured.attempts):.2f} drops each, "
        f"from {1e3 * min(measured.seconds['physics']):.0f} to {1e3 * max(measured.seconds['physics']):.0f} ms"
    )
    for name, frame in (("ideal", whole), ("stereo", whole + sensor)):
        minutes = SCENES * (measured.mean("physics") + VIEWS * (frame - stages["physics"])) / CORES / 60
        print(
            f"{SCENES:,} scenes x {VIEWS} views on {CORES} cores of one's own, {name}: {minutes:.1f} minutes, "
            f"{SCENES * VIEWS / minutes / 60:.0f} frames/s"
        )
    peak = measured.peak_mb
    print(
        f"memory of a worker: {peak[0]:.0f} MB at most after the first scene, {peak[-1]:.0f} MB after all {len(peak)}"
    )


def report_limit(job: Job, measured: Measured) -> None:
    """The share of what memory alone would allow, were every byte that a frame needs touched once."""
    vertices, faces = job.model.mesh
    pixels = job.config.camera.width * job.config.camera.height
    instances = float(np.mean([len(scene.world_from_obj) for scene in measured.scenes]))
    touched = {
        "the mesh, read for every instance": instances * (vertices.nbytes + faces.nbytes),
        "silhouettes, written and read": 8 * measured.silhouettes,
        "depth and ids, written and read": 2 * pixels * (4 + 2 + 2),
        "what is stored, written and hashed": 2 * measured.stored,
    }
    bandwidth, total = copy_bandwidth(), sum(touched.values())
    spent = sum(measured.mean(stage) for stage in ("raster", "quantize", "labels", "write", "seal"))
    parts = ", ".join(f"{name} {size / 1e6:.1f}" for name, size in touched.items())
    print(f"limit of raster, labels and write: {total / 1e6:.1f} MB a frame ({parts})")
    print(
        f"  at {bandwidth / 1e9:.1f} GB/s, this core's copying: {1e3 * total / bandwidth:.2f} ms; "
        f"{total / bandwidth / spent:.0%} of it reached; raster takes "
        f"{1e9 * measured.mean('raster') / measured.silhouettes:.0f} ns a silhouette's pixel"
    )


def copy_bandwidth() -> float:
    """Bytes a second that one core reads and writes when it copies what no cache holds."""
    source, target = np.ones(COPIED_MB << 20, np.uint8), np.ones(COPIED_MB << 20, np.uint8)
    return 2 * source.nbytes / least_seconds(lambda: np.copyto(target, source), 5)


def report_piles(job: Job, measured: Measured) -> None:
    hulls = hulls_of(job)
    piles = [scene.world_from_obj for scene in measured.scenes]
    depth = 1e3 * np.concatenate([penetrations(hulls, pile) for pile in piles])
    floor = 1e3 * np.concatenate([below_floor(hulls, pile) for pile in piles])
    moved = 1e3 * np.concatenate([
        motion_afterwards(job, scene.index, scene.world_from_obj, job.config.physics) for scene in measured.scenes
    ])  # fmt: skip
    print(f"piles of a {1e3 * job.model.diameter:.0f} mm object, mm")
    for name, values in (
        ("in each other, close pairs", depth), ("in the floor", floor), ("motion in the next 2 s", moved),
    ):  # fmt: skip
        quantiles = np.percentile(values, [50, 95, 99, 100])
        print(f"  {name:<28}" + "".join(f"{q:>6} {v:6.3f}" for q, v in zip(NAMES, quantiles, strict=True)))
    deciles = " ".join(f"{v:.2f}" for v in np.percentile(measured.visibility, range(10, 100, 10)))
    print(f"  geometric visibility: mean {np.mean(measured.visibility):.2f}, deciles {deciles}")


if __name__ == "__main__":
    main()
