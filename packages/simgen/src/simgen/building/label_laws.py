"""The laws of :mod:`evalkit.datasets.scene` that the labels of a frame obey; those that one breaks, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from evalkit.datasets.scene import View
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel

IDS = np.iinfo(np.uint16).max + 1  # values that a pixel of instance_id can have
RIGID = 1e-6
CENTER_PX = 0.01  # pixels; labels hold projections as float32
SAME_PLACE = 1e-6  # diameters that an instance at rest may seem to move between views
BOUNDS_SLACK = 1e-3  # diameters
SOUND_VISIBILITY, SOUND_PIXELS = 0.5, 50  # what well visible means
SOUND_SHARE = 0.1  # of a well visible instance's pixels, where depth has a sensor's errors: tiny ones are all edge


def broken_laws(view: View, model: ObjectModel, noisy: bool = False) -> Iterator[str]:
    """The laws that one frame's labels break, in sentences; none for a sound frame.

    `noisy` depth has a sensor's errors: it is held to the geometry by its bulk alone, and pixel by pixel where the
    ideal depth was kept.
    """
    labels = view.instances
    if not _rigid(view.cam_from_world):
        yield "cam_from_world is not a rigid transform."
    if not _rigid(labels.cam_from_obj):
        yield f"cam_from_obj of {_names(view, ~_each_rigid(labels.cam_from_obj))} is not a rigid transform."
        return
    broken_ids = list(_broken_ids(view))
    yield from broken_ids
    if not broken_ids:
        yield from _broken_counts(view)
        yield from _broken_boxes(view)
        yield from _broken_centers(view, model)
        yield from _broken_depth(view, model, noisy)


def _broken_ids(view: View) -> Iterator[str]:
    labels = view.instances
    if len(np.unique(labels.instance)) != len(labels):
        yield "two labels are of the same instance."
    if len(labels) and not (labels.instance.min() >= 0 and labels.instance.max() < IDS - 1):
        yield "an instance's number does not fit the 16 bits of instance_id."
        return
    unknown = np.setdiff1d(np.unique(view.instance_id), [0, *(labels.instance + 1)])
    if len(unknown):
        yield f"instance_id holds {unknown[0]}, which no label names."


def _broken_counts(view: View) -> Iterator[str]:
    labels = view.instances
    if (labels.pixels_geometric > labels.pixels_full).any():
        yield f"{_names(view, labels.pixels_geometric > labels.pixels_full)} has more visible pixels than pixels."
    for share, ids, which in (("geometric", view.instance_id, ""), ("returned", _shown_ids(view), " with depth")):
        pixels, visibility = getattr(labels, f"pixels_{share}"), getattr(labels, f"visibility_{share}")
        wrong = np.bincount(ids.ravel(), minlength=IDS)[labels.instance + 1] != pixels
        if wrong.any():
            yield f"pixels_{share} of {_names(view, wrong)} is not the number of its pixels{which}."
        expected = pixels / np.maximum(labels.pixels_full, 1)
        wrong = ~((visibility >= 0) & (visibility <= 1) & (np.abs(visibility - expected) < 1e-6))
        if wrong.any():
            yield f"visibility_{share} of {_names(view, wrong)} is not pixels_{share} / pixels_full."


def _broken_boxes(view: View) -> Iterator[str]:
    labels = view.instances
    slices = find_objects(_shown_ids(view), max_label=int(labels.instance.max(initial=0)) + 1)
    tight = np.array([_box(slices[instance]) for instance in labels.instance], int).reshape(-1, 4)
    wrong = (tight != labels.box_returned).any(1)
    if wrong.any():
        yield f"box_returned of {_names(view, wrong)} is not tight around its pixels with depth."
    x0, y0, x1, y1 = labels.box_full.T.astype(np.int64)
    outside = (x0 > tight[:, 0]) | (y0 > tight[:, 1]) | (x1 < tight[:, 2]) | (y1 < tight[:, 3])
    wrong = ((x1 - x0) * (y1 - y0) < labels.pixels_full) | (outside & (labels.pixels_returned > 0))
    if wrong.any():
        yield f"box_full of {_names(view, wrong)} does not hold its silhouette."


def _broken_centers(view: View, model: ObjectModel) -> Iterator[str]:
    labels, camera = view.instances, view.camera
    centers = model.centers(labels.cam_from_obj)
    before = centers[:, 2] > 0
    with np.errstate(invalid="ignore"):
        off = np.abs(camera.project(centers) - labels.center_px).max(1, initial=0.0)
    wrong = before & ~(off <= CENTER_PX + 1e-6 * np.abs(labels.center_px).max(1, initial=0.0))
    if wrong.any():
        yield f"center_px of {_names(view, wrong)} is not the projection of its centroid."


def _broken_depth(view: View, model: ObjectModel, noisy: bool) -> Iterator[str]:
    if view.depth_ideal is not None:
        if (view.depth_raw[view.depth_ideal_raw == 0] > 0).any():
            yield "depth has returns where depth_ideal has nothing."
        outside, _ = _outside(view, view.depth_ideal, model)
        if (outside > 0).any():
            yield f"depth_ideal at the pixels of {_names(view, outside > 0)} is outside its bounding sphere."
    outside, pixels = _outside(view, view.depth, model)
    wrong = outside > 0
    if noisy:
        well_visible = (view.instances.visibility_returned >= SOUND_VISIBILITY) & (pixels >= SOUND_PIXELS)
        wrong = well_visible & (outside > (1 - SOUND_SHARE) * pixels)
    if wrong.any():
        yield f"depth at the pixels of {_names(view, wrong)} is outside its bounding sphere."


def _outside(view: View, depth: NDArray[np.float32], model: ObjectModel) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of each label's pixels with depth: how many lie outside its bounding sphere (n,), and how many there are (n,)."""
    v, u = np.nonzero((view.instance_id > 0) & (depth > 0))
    row, points = _row_of_id(view)[view.instance_id[v, u]], view.camera.unproject(np.stack([u, v], -1), depth[v, u])
    distance = np.linalg.norm(points - model.centers(view.instances.cam_from_obj)[row], axis=1)
    limit = model.diameter * (0.5 + BOUNDS_SLACK) + 2 * view.depth_unit
    count = len(view.instances)
    return np.bincount(row[distance > limit], minlength=count), np.bincount(row, minlength=count)


def moved(
    view: View, model: ObjectModel, at_rest: dict[int, tuple[NDArray[np.int32], NDArray[np.float64]]]
) -> Iterator[str]:
    """Whether the instances lie where the scene's first view has them."""
    world_from_obj = poses.invert(view.cam_from_world) @ view.instances.cam_from_obj
    instance, first = at_rest.setdefault(view.scene_index, (view.instances.instance, world_from_obj))
    if not np.array_equal(instance, view.instances.instance):
        yield "its instances are not those of the scene's first view."
    elif len(first) and not np.abs(world_from_obj - first).max() < SAME_PLACE * max(1.0, model.diameter):
        yield "its instances do not lie where the scene's first view has them."


def _each_rigid(pose: NDArray[np.float64]) -> NDArray[np.bool_]:
    bottom = (pose[..., 3, :] == [0, 0, 0, 1]).all(-1)
    return np.asarray(poses.is_rotation(pose[..., :3, :3], RIGID) & bottom & np.isfinite(pose).all((-1, -2)))


def _rigid(pose: NDArray[np.float64]) -> bool:
    return bool(_each_rigid(pose).all())


def _shown_ids(view: View) -> NDArray[np.int32]:
    """instance_id (H, W) where there is depth, else 0."""
    return np.where(view.depth_raw > 0, view.instance_id, 0).astype(np.int32)


def _box(slices: tuple[slice, slice] | None) -> tuple[int, int, int, int]:
    if slices is None:
        return (0, 0, 0, 0)
    rows, columns = slices
    return (columns.start, rows.start, columns.stop, rows.stop)


def _row_of_id(view: View) -> NDArray[np.int64]:
    """Row among the labels of each value of instance_id; -1 for values that none has."""
    rows = np.full(IDS, -1)
    rows[view.instances.instance + 1] = np.arange(len(view.instances))
    return rows


def _names(view: View, wrong: NDArray[np.bool_]) -> str:
    """The first wrong instance, and how many more there are."""
    numbers = view.instances.instance[wrong]
    return f"instance {numbers[0]}" + (f" and {len(numbers) - 1} more" if len(numbers) > 1 else "")
