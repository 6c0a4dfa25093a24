"""One depth image and what is known about it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera

Share = Literal["geometric", "returned"]
SHARES: tuple[Share, ...] = ("geometric", "returned")


@dataclass(frozen=True, eq=False)
class Instances:
    """Labels of the n instances of a scene as one camera sees them, one row each; hidden ones included.

    Visibility has two shares of the whole silhouette. The *geometric* one is where the instance is the nearest surface,
    whatever the sensor did there; the *returned* one is that part of it whose stored depth has a return, right or
    wrong. Without a sensor's errors they are equal.

    Boxes are x0, y0, x1, y1 in pixel indices, x0 <= u < x1; an instance without such pixels has (0, 0, 0, 0).
    `box_full` and `pixels_full` are those of the whole silhouette, the part beyond the frame included.
    """

    instance: NDArray[np.int32]  # (n,) number of the instance within its scene; its pixels hold instance + 1
    cam_from_obj: NDArray[np.float64]  # (n, 4, 4)
    visibility_geometric: NDArray[np.float32]  # (n,) pixels_geometric / pixels_full, 0 where pixels_full is 0
    visibility_returned: NDArray[np.float32]  # (n,) pixels_returned / pixels_full, 0 where pixels_full is 0
    pixels_geometric: NDArray[np.int32]  # (n,)
    pixels_returned: NDArray[np.int32]  # (n,)
    pixels_full: NDArray[np.int32]  # (n,)
    box_returned: NDArray[np.int32]  # (n, 4) of the pixels with a return: what a detector can see
    box_full: NDArray[np.int32]  # (n, 4)
    center_px: NDArray[np.float32]  # (n, 2) projection of the object's centroid

    def visibility(self, share: Share) -> NDArray[np.float64]:
        """One of the two shares (n,)."""
        chosen = self.visibility_geometric if share == "geometric" else self.visibility_returned
        return chosen.astype(np.float64)

    def __len__(self) -> int:
        return len(self.instance)

    def __getitem__(self, rows: NDArray[np.generic] | slice) -> Instances:
        return Instances(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class View:
    """One frame of a scene. `instance_id` holds 0 for everything that is not an instance, else instance + 1."""

    camera: Camera
    depth_raw: NDArray[np.uint16]  # (height, width), 0 = no return
    depth_unit: float  # meters per step of depth_raw
    instance_id: NDArray[np.uint16]  # (height, width)
    cam_from_world: NDArray[np.float64]  # (4, 4)
    instances: Instances
    scene_index: int
    view_index: int
    depth_ideal_raw: NDArray[np.uint16] | None = None  # (height, width), as no sensor's error has changed it, if kept

    @property
    def depth(self) -> NDArray[np.float32]:
        """Axial depth in meters (height, width), 0 = no return."""
        return self.depth_raw.astype(np.float32) * np.float32(self.depth_unit)

    @property
    def depth_ideal(self) -> NDArray[np.float32] | None:
        """Axial depth in meters (height, width) without the sensor's errors, 0 = nothing there; None if not kept."""
        ideal = self.depth_ideal_raw
        return None if ideal is None else ideal.astype(np.float32) * np.float32(self.depth_unit)

    @property
    def image_id(self) -> str:
        """The name by which gt.json and preds.json know this image."""
        return f"{self.scene_index:06d}-{self.view_index:03d}"


@dataclass(frozen=True, eq=False)
class Scene:
    """Instances at rest: what the physics hands to the renderer."""

    index: int
    world_from_obj: NDArray[np.float64]  # (n, 4, 4)
    cam_from_world: NDArray[np.float64]  # (views, 4, 4)
