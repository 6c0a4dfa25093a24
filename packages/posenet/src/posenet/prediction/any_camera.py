"""Images of any camera on the pixel grid that a network was trained for, and what no network could make sense of."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.network.depth_input import scene_depth
from posenet.network.pose_network import PoseNetwork

TOLERANCE = 0.02  # focal lengths this close to the training camera's need no resampling
FARTHER = 1.4  # times the training set's depths, from where on images are enlarged to the trained size of objects
STEPS_AN_OCTAVE = 4  # in which they are enlarged, so that images of one sequence share a grid
LEAST_PIXELS = 6.0  # an object smaller than this in its image shows nothing
LARGEST_SHARE = 1.5  # nor does one larger than so many image sides
MOST_PIXELS = 40e6  # of a resampled image


def distance(depth: NDArray[np.float32], network: PoseNetwork) -> float:
    """How far away (meters) an image shows what may be the object."""
    return float(scene_depth(torch.from_numpy(depth)[None], network.depth_range, network.model.diameter))


def check_distance(depth: NDArray[np.float32], camera: Camera, network: PoseNetwork, title: str) -> None:
    """Refuse what cannot show the object: another unit, another camera, depths that absolute bins do not reach.

    Raises:
        InputError: it cannot.
    """
    seen = depth[depth > 0]
    if len(seen) == 0:
        return
    median = distance(depth, network)
    size, side = camera.fx * network.model.diameter / median, max(camera.width, camera.height)
    if not LEAST_PIXELS <= size <= LARGEST_SHARE * side:
        raise InputError(
            f"{title}: at its depth of {median:.4g} m the object would be {size:.3g} pixels across in "
            f"{camera.width} x {camera.height}; check the unit of the depths (--depth-unit 0.001 for millimeters) and "
            "the camera's focal length."
        )
    bins = network.codec.depth_bins
    if network.config.network.depth == "absolute" and not ((seen >= bins.low) & (seen <= bins.high)).any():
        raise InputError(
            f"{title}: its depths ({seen.min():.4g} to {seen.max():.4g} m) lie outside those that the model was "
            f"trained for ({bins.low:.3g} to {bins.high:.3g} m); train on shards with the camera at this distance."
        )


def trained_grid(depth: NDArray[np.float32], camera: Camera, network: PoseNetwork) -> Camera:
    """The camera whose images show the object in the size that the network knows.

    Its focal lengths are the training camera's, and larger (or smaller) in proportion where the scene is farther (or
    nearer) than the training set's; a network with absolute depth bins knows its own distances only. (Six scenes of
    bunnies seen 0.5 m farther off than any it was trained on: AP 0.68 where without enlargement it is 0; 0.66 at home.)
    """
    zoom = _zoom(depth, network) if network.config.network.depth == "relative" else 1.0
    scale_x, scale_y = zoom * network.camera.fx / camera.fx, zoom * network.camera.fy / camera.fy
    if abs(scale_x - 1.0) < TOLERANCE and abs(scale_y - 1.0) < TOLERANCE:
        return camera
    width, height = max(1, round(camera.width * scale_x)), max(1, round(camera.height * scale_y))
    if width * height > MOST_PIXELS:
        raise InputError(
            f"the camera's focal length of {camera.fx:.4g} x {camera.fy:.4g} pixels would need an image of "
            f"{width} x {height}; check fx and fy, or crop the image to the bin."
        )
    return camera.sampled(width, height)


def _zoom(depth: NDArray[np.float32], network: PoseNetwork) -> float:
    """How much larger the object must become to have its trained size; 1 within or about the trained distances."""
    if not depth.any():
        return 1.0
    near, far = network.depth_range
    median = distance(depth, network)
    if near / FARTHER <= median <= far * FARTHER:
        return 1.0
    return float(2 ** (round(STEPS_AN_OCTAVE * np.log2(2 * median / (near + far))) / STEPS_AN_OCTAVE))
