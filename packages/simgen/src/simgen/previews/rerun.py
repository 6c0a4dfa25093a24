"""Shards as a recording for the rerun viewer: bin, instances, cameras and their images, frame by frame."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from simgen.physics.bin_size import recorded_bin
from simgen.previews.scene_viewer import drawn_mesh
from simgen.previews.sheet import instance_colors

APPLICATION = "binpose"
SUFFIX = ".rrd"
CAMERA = "world/camera"
IMAGE_PLANE = 0.25  # of the distance from the camera to the bin's floor
BACKGROUND_COLOR = (70, 75, 80)


def save_recording(dataset: ShardDataset, frames: Sequence[int], path: Path) -> None:
    """Write the frames as a file that ``rerun FILE`` opens.

    Raises:
        InputError: rerun is not installed, or the file's name is not that of a recording.
    """
    if path.suffix.lower() != SUFFIX:
        raise InputError(f"--save {path}: a recording's name must end in {SUFFIX}.")
    rerun = _rerun()
    with atomic_path(path) as temporary:
        recording = rerun.RecordingStream(APPLICATION)
        recording.save(temporary, default_blueprint=_layout())
        _log(recording, rerun, dataset, frames)
        recording.flush()
        recording.disconnect()


def open_viewer(dataset: ShardDataset, frames: Sequence[int]) -> None:
    """Show the frames in rerun's window, which stays when we end.

    Raises:
        InputError: rerun is not installed, or there is no display.
    """
    rerun = _rerun()
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"simgen view: there is no display here; write a recording with --save scenes{SUFFIX} instead."
        )
    recording = rerun.RecordingStream(APPLICATION)
    recording.spawn(default_blueprint=_layout())
    _log(recording, rerun, dataset, frames)
    recording.flush()


def _rerun() -> ModuleType:
    try:
        import rerun
    except ImportError:
        raise InputError(
            "simgen view: rerun is not installed; run pip install 'binpose-simgen[view]', "
            "or look at 'simgen preview SHARDS -o page.html'."
        ) from None
    return rerun


def _layout() -> Any:
    from rerun import blueprint

    images = blueprint.Vertical(
        blueprint.Spatial2DView(origin=f"{CAMERA}/depth", name="depth"),
        blueprint.Spatial2DView(origin=f"{CAMERA}/instances", name="instances, visible boxes"),
    )
    scene = blueprint.Spatial3DView(origin="world", name="scene", contents=["$origin/**", f"- {CAMERA}/instances/**"])
    return blueprint.Blueprint(
        blueprint.Horizontal(scene, images, column_shares=[3, 2]),
        blueprint.TimePanel(timeline="frame", state="collapsed"),
        blueprint.SelectionPanel(state="collapsed"),
    )


def _log(recording: Any, rerun: ModuleType, dataset: ShardDataset, frames: Sequence[int]) -> None:
    recording.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    heap = _Heap(recording, rerun, dataset.header.object)
    for number, frame in enumerate(frames):
        view: View = dataset[frame]
        recording.set_time("frame", sequence=number)
        recording.set_time("scene", sequence=view.scene_index)
        if heap.scene != view.scene_index:
            heap.show(view)
            _log_bin(recording, rerun, dataset.header.config, view.scene_index)
        _log_camera(recording, rerun, view)


class _Heap:
    """The instances of the scene that is shown; a mesh is sent again only where it was taken away."""

    def __init__(self, recording: Any, rerun: ModuleType, model: ObjectModel) -> None:
        self._recording, self._rerun = recording, rerun
        self._vertices, self._faces = drawn_mesh(model)
        self._shown: set[int] = set()
        self.scene = -1

    def show(self, view: View) -> None:
        self.scene, labels = view.scene_index, view.instances
        world_from_obj = poses.invert(view.cam_from_world) @ labels.cam_from_obj
        numbers = [int(instance) for instance in labels.instance]
        colors = _colors(max(numbers, default=-1) + 1)
        for gone in self._shown - set(numbers):
            self._recording.log(_instance(gone), self._rerun.Clear(recursive=True))
        for number, pose in zip(numbers, world_from_obj, strict=True):
            turn, position = pose[:3, :3], pose[:3, 3]
            self._recording.log(_instance(number), self._rerun.Transform3D(translation=position, mat3x3=turn))
            if number not in self._shown:
                self._recording.log(_instance(number), self._mesh(colors[number]))
        self._shown = set(numbers)

    def _mesh(self, color: NDArray[np.uint8]) -> Any:
        return self._rerun.Mesh3D(
            vertex_positions=self._vertices, triangle_indices=self._faces, albedo_factor=color.tolist()
        )


def _instance(number: int) -> str:
    return f"world/instances/{number:03d}"


def _log_bin(recording: Any, rerun: ModuleType, config: dict[str, Any], scene: int) -> None:
    size = recorded_bin(config, scene)
    if size is None:
        return
    height = size.height if size.walls else 0.0
    box = rerun.Boxes3D(
        centers=[[0, 0, height / 2]],
        half_sizes=[[size.width / 2, size.depth / 2, height / 2]],
        colors=[BACKGROUND_COLOR],
    )
    recording.log("world/bin", box)


def _log_camera(recording: Any, rerun: ModuleType, view: View) -> None:
    camera, labels = view.camera, view.instances
    world_from_cam = poses.invert(view.cam_from_world)
    pinhole = rerun.Pinhole(
        focal_length=[camera.fx, camera.fy],
        principal_point=[camera.cx + 0.5, camera.cy + 0.5],  # rerun counts from the pixel's corner
        width=camera.width,
        height=camera.height,
        camera_xyz=rerun.ViewCoordinates.RDF,
        image_plane_distance=IMAGE_PLANE * abs(world_from_cam[2, 3]),
    )
    pose = rerun.Transform3D(translation=world_from_cam[:3, 3], mat3x3=world_from_cam[:3, :3])
    colors = _colors(int(labels.instance.max(initial=-1)) + 1)
    classes = [(0, "background", BACKGROUND_COLOR)]
    classes += [(i + 1, str(i), tuple(color)) for i, color in enumerate(colors.tolist())]
    shown = labels[labels.pixels_returned > 0]
    boxes = rerun.Boxes2D(
        array=shown.box_returned,
        array_format=rerun.Box2DFormat.XYXY,
        class_ids=shown.instance + 1,
        labels=[
            f"{number}: {visibility:.0%}"
            for number, visibility in zip(shown.instance, shown.visibility_geometric, strict=True)
        ],
    )
    recording.log(CAMERA, pose, pinhole)
    recording.log(f"{CAMERA}/depth", rerun.DepthImage(view.depth_raw, meter=1 / view.depth_unit))
    recording.log(f"{CAMERA}/instances", rerun.AnnotationContext(classes))
    recording.log(f"{CAMERA}/instances", rerun.SegmentationImage(view.instance_id))
    recording.log(f"{CAMERA}/instances/visible", boxes)


def _colors(count: int) -> NDArray[np.uint8]:
    """RGB (count, 3), those of the contact sheet."""
    return (255 * instance_colors(count)).round().astype(np.uint8)
