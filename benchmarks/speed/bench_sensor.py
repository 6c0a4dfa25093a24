"""How like another depth camera's the simulated errors are: our figures beside those of Siléane's noisy bunny.

That bunny's noise is a simulated block-matching camera's, published with the dataset; its figures are explained in
docs/own-camera.md. The three Siléane bunny scenes are rendered at their ground-truth poses with their camera, 1.3 m
off, as there; where the reference data is missing, heaps of random bunnies stand in. Time is CPU time.

python benchmarks/speed/bench_sensor.py [--sensor stereo,baseline=0.1] [--repeats 5] [--picture sensor.png]
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.sileane import dataset as sileane
from evalkit.drawing.overlays import shade
from evalkit.drawing.plots import new_figure, save
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.meshes.load import load_object
from evalkit.objects.model import ObjectModel
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.presets import default_camera
from simgen.rendering.rasterizer import Rasterizer, Rendering
from simgen.sensors.sensor import measure
from simgen.sensors.sensor_config import SensorConfig
from simgen.sensors.sensor_text import parse_sensor

REFERENCE = Path(os.environ.get("BINPOSE_REFERENCE", Path(__file__).resolve().parents[3] / "shared" / "reference"))
SLOPES = ((0, 31), (31, 45), (45, 60), (60, 72))  # degrees
LAGS = (1, 2, 3, 5)  # pixels
STEP, FAR_FROM_STEP, CLOSE = 0.020, 10, 4  # meters; pixels
Depth = NDArray[np.float32]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensor", default="stereo", help="as of simgen build (stereo)")
    parser.add_argument("--repeats", type=int, default=5, help="measurements of each scene (5)")
    parser.add_argument("--picture", type=Path, help="draw ideal and measured depth and shaded surface there")
    options = parser.parse_args()
    sensor = parse_sensor(options.sensor)
    if sensor is None:
        raise SystemExit("an ideal sensor has no errors to show")
    camera, heaps = scenes()
    pairs = [
        (heap.rendering.depth, measure(heap.rendering.depth, camera, sensor, np.random.default_rng([scene, repeat])))
        for repeat in range(options.repeats)
        for scene, heap in enumerate(heaps)
    ]
    typical = float(np.median([np.median(ideal[ideal > 0]) for ideal, _ in pairs]))
    print(sensor.describe(camera, typical, typical))
    print(f"{'':42}{'Siléane':>8} {options.sensor:>8}")
    for name, expected, ours in statistics(camera, pairs):
        print(f"{name:42}{expected:>8} {ours:8.3g}")
    for name, depths in (("ideal", [heap.rendering.depth for heap in heaps]), (sensor.model, [m for _, m in pairs])):
        if all(heap.visibility is not None for heap in heaps):
            expected, off = "0.060" if name == "ideal" else "0.011", visibility_error(heaps, depths)
            print(f"{f'visibility off the published, {name} depth':42}{expected:>8} {off:8.2g}")
    print(f"{'ms a frame at 640 x 480, CPU time':42}{'<= 15':>8} {1e3 * seconds_a_frame(sensor):8.3g}")
    if options.picture:
        draw(camera, *pairs[0], options.picture)
        print(f"{options.picture} written")


@dataclass(frozen=True, eq=False)
class Heap:
    """One scene: what is seen ideally, and the visibility (n,) that was published for its instances, if any."""

    rendering: Rendering
    visibility: NDArray[np.float64] | None


def scenes() -> tuple[Camera, list[Heap]]:
    """Camera and heaps of the reference scenes, or of heaps that stand in for them."""
    source = REFERENCE / "sileane_bunny"
    if source.is_dir():
        truth = sileane.read_ground_truth(source)
        model = load_object(source / "mesh.obj", units="m")
        layouts = [image.cam_from_obj for image in truth.images]
        camera, floor = truth.images[0].camera, 1.5
        published: list[NDArray[np.float64] | None] = [image.visibility for image in truth.images]
    else:
        print(f"no reference data at {REFERENCE}: heaps of random bunnies instead")
        model = ObjectModel.from_mesh("bunny", *BUILTIN_OBJECTS["bunny"].make())
        camera, floor, rng = Camera(506, 474, 1152.31, 1152.31, 252.5, 236.5), 1.5, np.random.default_rng(0)
        layouts = [
            poses.from_rotation_translation(
                poses.random_rotations(rng, 70),
                np.column_stack([rng.uniform(-0.25, 0.25, (70, 2)), rng.uniform(1.2, 1.45, 70)]),
            )
            for _ in range(3)
        ]
        published = [None] * len(layouts)
    assert camera is not None
    rasterizer = Rasterizer(camera, *mesh_of(model), plane(floor))
    heaps = zip(layouts, published, strict=True)
    return camera, [Heap(rasterizer.render(layout, np.eye(4)), visibility) for layout, visibility in heaps]


def visibility_error(heaps: list[Heap], depths: list[Depth]) -> float:
    """Mean absolute difference between published visibility and that in `depths`, scene after scene, over and over."""
    off = []
    for number, depth in enumerate(depths):
        heap = heaps[number % len(heaps)]
        full = heap.rendering.pixels_full
        seen = np.bincount(heap.rendering.instance_id[depth > 0], minlength=len(full) + 1)[1:]
        assert heap.visibility is not None
        off.append(np.abs(seen / np.maximum(full, 1) - heap.visibility))
    return float(np.concatenate(off).mean())


def mesh_of(model: ObjectModel) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    assert model.vertices is not None and model.faces is not None
    return model.vertices, model.faces


def plane(z: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    corners = np.array([[-5, -5, z], [5, -5, z], [5, 5, z], [-5, 5, z]], float)
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def statistics(camera: Camera, pairs: list[tuple[Depth, Depth]]) -> list[tuple[str, str, float]]:
    """(name, Siléane's figure, ours) of each figure, over all (ideal, measured) pairs."""
    rows = [("missing, %", "16.6", 100 * mean([(m == 0).mean() for _, m in pairs]))]
    by_slope: dict[tuple[int, int], list[Depth]] = {slopes: [] for slopes in SLOPES}
    smooth, close, right, left, edge = [], [], [], [], list[Depth]()
    lags: dict[int, list[float]] = {lag: [] for lag in LAGS}
    for ideal, measured in pairs:
        step = distance_to_big_step(ideal)
        slope, error, returned = slopes_of(camera, ideal), measured - ideal, measured > 0
        far = (step > FAR_FROM_STEP) & (slope < 72)
        smooth.append(returned[far])
        close.append(returned[step <= CLOSE])
        edge.append(np.abs(error[(step <= CLOSE) & returned]))
        a, b = ideal[:, :-1], ideal[:, 1:]
        right.append(returned[:, 1:][b - a > STEP])
        left.append(returned[:, :-1][a - b > STEP])
        good = far & returned & (np.abs(error) < 0.02)
        for low, high in SLOPES:
            by_slope[low, high].append(error[good & (low <= slope) & (slope < high)])
        flat = good & (slope < 31)
        for lag in LAGS:
            both = flat[:, lag:] & flat[:, :-lag]
            lags[lag].append(np.corrcoef(error[:, lag:][both], error[:, :-lag][both])[0, 1])
    rows += [("missing on smooth surface, %", "2.5-3", missing(smooth))]
    rows += [(f"missing within {CLOSE} px of a step > 20 mm, %", "33", missing(close))]
    rows += [("missing right behind such a step, on its left", "74", missing(left))]
    rows += [("                                on its right", "53", missing(right))]
    rows += [("error near such steps, 95th percentile, mm", "79", 1e3 * float(np.percentile(np.concatenate(edge), 95)))]
    expected = dict(zip(SLOPES, ("1.7", "1.9", "2.2", "2.5"), strict=True))
    rows += [
        (f"sigma at {low} to {high} degrees of slope, mm", expected[low, high], 1e3 * float(np.concatenate(e).std()))
        for (low, high), e in by_slope.items()
    ]
    expected_lag = dict(zip(LAGS, ("0.63", "0.44", "0.32", "0.17"), strict=True))
    return rows + [(f"correlation at {lag} px", expected_lag[lag], mean(lags[lag])) for lag in LAGS]


def mean(values: list[float]) -> float:
    return float(np.mean(values))


def missing(returned: list[NDArray[np.bool_]]) -> float:
    """Per cent without a return."""
    return 100 * (1 - float(np.concatenate(returned).mean()))


def distance_to_big_step(ideal: Depth) -> NDArray[np.float64]:
    """Chessboard distance (H, W) to the other side of the nearest step of more than STEP meters."""
    from scipy.ndimage import distance_transform_cdt

    beside = np.zeros(ideal.shape, bool)
    across, down = np.abs(np.diff(ideal, axis=1)) > STEP, np.abs(np.diff(ideal, axis=0)) > STEP
    beside[:, 1:] |= across
    beside[:, :-1] |= across
    beside[1:] |= down
    beside[:-1] |= down
    return np.asarray(distance_transform_cdt(~beside, "chessboard") + 1, float)


def slopes_of(camera: Camera, ideal: Depth) -> NDArray[np.float64]:
    """Angle in degrees (H, W) between the surface's normal and the optical axis's direction, by central differences."""
    dv, du = np.gradient(ideal.astype(float))
    return np.degrees(np.arctan(np.hypot(du * camera.fx, dv * camera.fy) / np.maximum(ideal, 1e-9)))


def seconds_a_frame(sensor: SensorConfig) -> float:
    """CPU seconds for one 640 x 480 frame of fifteen bunnies, the least of 20."""
    camera, rng = default_camera(640, 480), np.random.default_rng(0)
    model = ObjectModel.from_mesh("bunny", *BUILTIN_OBJECTS["bunny"].make())
    heap = poses.from_rotation_translation(
        poses.random_rotations(rng, 15), np.column_stack([rng.uniform(-0.2, 0.2, (15, 2)), rng.uniform(0.6, 0.7, 15)])
    )
    ideal = Rasterizer(camera, *mesh_of(model), plane(0.75)).render(heap, np.eye(4)).depth
    least = np.inf
    for repeat in range(20):
        start = time.process_time()
        measure(ideal, camera, sensor, np.random.default_rng(repeat))
        least = min(least, time.process_time() - start)
    return float(least)


def draw(camera: Camera, ideal: Depth, measured: Depth, path: Path) -> None:
    """Ideal above, measured below: depth in colors, and the surface shaded by its normals."""
    figure = new_figure(11, 10)
    axes = figure.subplots(2, 2)
    low, high = np.percentile(ideal[ideal > 0], [0.5, 99.5])
    for row, depth, name in zip(axes, (ideal, measured), ("ideal", "measured"), strict=True):
        row[0].imshow(np.where(depth > 0, depth, np.nan), cmap="viridis_r", vmin=low, vmax=high)
        row[0].set_facecolor("black")
        row[1].imshow(shade(depth, camera)[..., ::-1])
        row[0].set_title(f"{name} depth, black: no return", loc="left")
        for panel in row:
            panel.set_xticks([])
            panel.set_yticks([])
    save(figure, path)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(str(error)) from None
