"""One scene, in two stages that need nothing of each other but the poses: simulate, then render."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Scene, View
from evalkit.datasets.shard_format import ShardHeader
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.config import BinSize, BuildConfig
from simgen.physics.bin import bin_mesh, fill_level, fitting_bin, ground_half_side, scene_bin, smallest_bin
from simgen.rendering.labels import label_instances, quantised
from simgen.rendering.renderers import depth_renderer
from simgen.rendering.viewpoints import distance_range, draw_viewpoints, farthest_ground
from simgen.scenes.recorded import RecordedScenes
from simgen.sensors.sensor import measure, sensor_generator

if TYPE_CHECKING:
    from simgen.physics.pile import Part

DEPTH_UNIT = 1e-4  # metres, unless the scene is much larger or smaller than a table
STEPS_PER_DIAMETER = 500  # 0.1 mm will do for objects of 5 cm and more
MIN_STEPS_PER_DIAMETER = 50
MIN_PIXELS = 4
MAX_FILL = 1.5  # heaps rise above the walls, but no higher
STEPS = np.iinfo(np.uint16).max
SOFTWARE = ("binpose-simgen", "binpose-evalkit", "numpy", "numba", "h5py", "hdf5plugin")
PHYSICS_SOFTWARE = ("pybullet",)


@dataclass(frozen=True, eq=False)
class Job:
    """All that the bytes of a dataset depend on. Make it with :func:`plan`.

    Scenes are simulated with the convex parts, unless they are `recorded`.
    """

    config: BuildConfig
    bin: BinSize
    model: ObjectModel
    convex_parts: list[Part]
    depth_unit: float
    recorded: RecordedScenes | None = None

    def for_shard(self, shard: int) -> Job:
        """As much of the job as the shard needs."""
        if self.recorded is None:
            return self
        return replace(self, recorded=self.recorded.only(self.config.scenes_of_shard(shard)))

    def scene(self, index: int) -> tuple[Scene, int]:
        """Scene number `index`, recorded or simulated now, its cameras placed; and how many drops it took."""
        return simulate_scene(self, index) if self.recorded is None else _recorded_scene(self, self.recorded, index)

    def scene_bin(self, scene: int) -> BinSize:
        """The bin of scene number `scene`."""
        return scene_bin(self.config.pile, self.bin, self.config.seed, scene)

    def header(self) -> ShardHeader:
        """What all shards of the dataset share; of recorded scenes, as if they had been simulated here."""
        origin, physics_software = self._origin()
        config, software = self.config.to_json() | origin, _versions(SOFTWARE) | physics_software
        return ShardHeader(self.config.camera, self.depth_unit, self.model, config, self.config.seed, software)

    def _origin(self) -> tuple[dict[str, Any], dict[str, str]]:
        """What the header's config says of where the scenes come from, and the software that made their poses."""
        if self.recorded is None:
            digest = fingerprint([_mesh_of(self.model), *self.convex_parts])
            return {"geometry_sha256": digest}, _versions(PHYSICS_SOFTWARE)
        made_with = self.recorded.software
        return self.recorded.origin, {name: made_with[name] for name in PHYSICS_SOFTWARE if name in made_with}


def software_here() -> dict[str, str]:
    """Versions of what decides the bytes of shards, as far as it is installed."""
    return _versions(SOFTWARE) | _versions(name for name in PHYSICS_SOFTWARE if _installed(name))


def _versions(names: Iterable[str]) -> dict[str, str]:
    return {name: version(name) for name in names}


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def plan(
    config: BuildConfig, model: ObjectModel, convex_parts: list[Part], recorded: RecordedScenes | None = None
) -> Job:
    """Settle what depends on the object's size: the bin, where it is automatic, and the depth unit.

    Raises:
        InputError: the object is larger than the bin, or the camera cannot see it.
    """
    diameter, (vertices, _) = model.diameter, _mesh_of(model)
    size = config.bin or fitting_bin(vertices, diameter, config.instances_max, config.pile)
    smallest = smallest_bin(config.pile, size)
    jitter = "" if smallest == size else f" less --bin-jitter {config.pile.bin_jitter:g}"
    if min(smallest.width, smallest.depth) < diameter:
        raise InputError(
            f"--bin {size}{jitter}: the object '{model.title}' is {diameter:g} m across; "
            "give a bin whose width and depth are larger, in metres, or --bin auto."
        )
    if fill_level(vertices, smallest, config.instances_max) > MAX_FILL:
        raise InputError(
            f"--bin {size}{jitter}: {config.instances_max} instances of '{model.title}' do not fit into it; "
            "give a larger --bin in metres or fewer --instances."
        )
    nearest, farthest = distance_range(config.viewpoints, config.camera, size, diameter)
    _require_sight(config.camera, diameter, farthest)
    if config.sensor is not None:
        config.sensor.require_range(config.camera, nearest)
    aside = config.viewpoints.look_at_jitter * math.hypot(size.width, size.depth)
    corner = farthest + aside + math.sqrt(2) * (1 + config.pile.bin_jitter) * ground_half_side(size)
    unit = depth_unit_for(min(corner, farthest_ground(config.viewpoints, config.camera, size, farthest)), diameter)
    return Job(replace(config, bin=size), size, model, convex_parts, unit, recorded)


def camera_distances(job: Job) -> tuple[float, float]:
    """Nearest and farthest distance in metres of the cameras from the bin's middle."""
    return distance_range(job.config.viewpoints, job.config.camera, job.bin, job.model.diameter)


def _require_sight(camera: Camera, diameter: float, farthest: float) -> None:
    if not (0 <= camera.cx <= camera.width - 1 and 0 <= camera.cy <= camera.height - 1):
        raise InputError(
            f"--camera: its principal point ({camera.cx:g}, {camera.cy:g}) lies outside the image, "
            "so that it would not see the bin that it is aimed at; give cx and cy within the image, in pixels."
        )
    pixels = min(camera.fx, camera.fy) * diameter / farthest
    if pixels < MIN_PIXELS:
        raise InputError(
            f"--camera: the object would be only {pixels:.1f} pixels across; "
            "give more pixels, a longer focal length in pixels, or a smaller --bin."
        )


def depth_unit_for(farthest: float, diameter: float) -> float:
    """Metres a step: 0.1 mm, or the power of ten that reaches `farthest` in 16 bits where 0.1 mm is too fine or coarse.

    Raises:
        InputError: from that far 16 bits cannot resolve the object.
    """
    if farthest <= STEPS * DEPTH_UNIT and diameter >= STEPS_PER_DIAMETER * DEPTH_UNIT:
        return DEPTH_UNIT
    unit = float(f"1e{math.ceil(math.log10(farthest / STEPS))}")
    if diameter < MIN_STEPS_PER_DIAMETER * unit:
        raise InputError(
            f"--camera: it would stand {farthest:.3g} m off to see the whole bin, too far for an object of "
            f"{diameter:.3g} m in 16 bits of depth; give a shorter focal length in pixels, or a smaller --bin."
        )
    return unit


def simulate_scene(job: Job, index: int) -> tuple[Scene, int]:
    """Scene number `index`, its instances at rest and its cameras placed; and how many drops it took."""
    from simgen.physics.pile import Body, simulate_pile

    config = job.config
    body = Body.from_parts(job.convex_parts, config.physics.simulated_diameter)
    instances = (config.instances_min, config.instances_max)
    size = job.scene_bin(index)
    pile = simulate_pile(body, size, instances, config.physics, config.seed, index, config.pile)
    return Scene(index, pile.world_from_obj, _drawn_cameras(job, index)), pile.attempts


def _recorded_scene(job: Job, recorded: RecordedScenes, index: int) -> tuple[Scene, int]:
    place = index - recorded.first
    cameras = _drawn_cameras(job, index) if recorded.cam_from_world is None else recorded.cam_from_world[place]
    return Scene(index, recorded.world_from_obj[place], cameras), recorded.attempts[place]


def _drawn_cameras(job: Job, index: int) -> NDArray[np.float64]:
    """`cam_from_world` (views, 4, 4) of scene number `index`."""
    config = job.config
    return draw_viewpoints(
        config.viewpoints, config.camera, job.bin, job.model.diameter, config.seed, index, config.views
    )


class SceneRenderer:
    """Turns scenes into labelled views; needs no physics."""

    def __init__(self, job: Job) -> None:
        self._job, self._camera, self._unit, self._model = job, job.config.camera, job.depth_unit, job.model
        mesh, background = _mesh_of(job.model), bin_mesh(job.bin)
        self._renderer = depth_renderer(job.config.renderer, self._camera, mesh, background)

    def views(self, scene: Scene) -> Iterator[View]:
        """The scene's frames, one for each of its cameras."""
        self._renderer.set_background(*bin_mesh(self._job.scene_bin(scene.index)))
        for view, cam_from_world in enumerate(scene.cam_from_world):
            cam_from_obj = cam_from_world @ scene.world_from_obj
            rendering = self._renderer.render(cam_from_obj, cam_from_world)
            depth = quantised(self._measured(rendering.depth, scene.index, view), self._unit)
            yield View(
                camera=self._camera,
                depth_raw=depth,
                depth_unit=self._unit,
                instance_id=rendering.instance_id,
                cam_from_world=cam_from_world,
                instances=label_instances(rendering, depth, cam_from_obj, self._model, self._camera),
                scene_index=scene.index,
                view_index=view,
                depth_ideal_raw=quantised(rendering.depth, self._unit) if self._job.config.keep_ideal else None,
            )

    def _measured(self, ideal: NDArray[np.float32], scene: int, view: int) -> NDArray[np.float32]:
        """What the config's sensor tells of an ideal depth image (H, W), in metres."""
        if self._job.config.sensor is None:
            return ideal
        return measure(
            ideal, self._camera, self._job.config.sensor, sensor_generator(self._job.config.seed, scene, view)
        )


def _mesh_of(model: ObjectModel) -> Part:
    if model.vertices is None or model.faces is None:
        raise InputError(f"object '{model.title}' has no mesh; give a mesh file to --object.")
    return model.vertices, model.faces


def fingerprint(geometry: Iterable[Iterable[NDArray[Any]]]) -> str:
    """SHA-256 of the arrays: the mesh that is drawn, then the hulls that fall, or the poses where none do."""
    digest = hashlib.sha256()
    for array in (array for part in geometry for array in part):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
