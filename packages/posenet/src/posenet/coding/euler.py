"""The rotation's three angles: R = Rz(a) Ry(b) Rz(c), batch first, radians.

a is the in-plane angle, b in [0, pi] the tilt of the object's z axis away from the viewing ray, c the spin about the
object's own z. At b = 0 (and pi) only a + c (a - c) is determined; a takes it all and c is 0.

Allocentric rotations are relative to the ray through the object's center, so that what a region shows depends on the
rotation alone and not on where in the image the region lies.
"""

from __future__ import annotations

import torch
from torch import Tensor


def from_angles(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """Angles (...) to rotations (..., 3, 3)."""
    ca, sa, cb, sb, cc, sc = a.cos(), a.sin(), b.cos(), b.sin(), c.cos(), c.sin()
    rows = [
        ca * cb * cc - sa * sc, -ca * cb * sc - sa * cc, ca * sb,
        sa * cb * cc + ca * sc, -sa * cb * sc + ca * cc, sa * sb,
        -sb * cc, sb * sc, cb,
    ]  # fmt: skip
    return torch.stack(torch.broadcast_tensors(*rows), -1).unflatten(-1, (3, 3))


def to_angles(rotation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rotations (..., 3, 3) to a and c in [-pi, pi] and b in [0, pi], each (...)."""
    sine = (rotation[..., 0, 2].square() + rotation[..., 1, 2].square()).sqrt()  # ONNX has no hypot
    b = torch.atan2(sine, rotation[..., 2, 2])
    a = torch.atan2(rotation[..., 1, 2], rotation[..., 0, 2])
    c = torch.atan2(rotation[..., 2, 1], -rotation[..., 2, 0])
    # At b = 0 R is Rz(a + c); at b = pi it is Rz(a - c) Ry(pi), whose second column is that of Rz(a - c).
    only = torch.atan2(-rotation[..., 0, 1], rotation[..., 1, 1])
    singular = sine < 1e-6
    return torch.where(singular, only, a), b, torch.where(singular, torch.zeros_like(c), c)


def ray_rotation(center: Tensor) -> Tensor:
    """The smallest rotation (..., 3, 3) that turns the optical axis into the ray to `center` (..., 3), in front."""
    x, y, z = torch.nn.functional.normalize(center, dim=-1).unbind(-1)
    k = 1.0 / (1.0 + z).clamp(min=1e-6)
    rows = [1 - k * x * x, -k * x * y, x, -k * x * y, 1 - k * y * y, y, -x, -y, z]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def from_6d(vectors: Tensor) -> Tensor:
    """Six numbers (..., 6) to rotations (..., 3, 3) by Gram-Schmidt on two columns (Zhou et al., CVPR 2019)."""
    first = torch.nn.functional.normalize(vectors[..., :3], dim=-1, eps=1e-6)
    second = vectors[..., 3:] - (first * vectors[..., 3:]).sum(-1, keepdim=True) * first
    second = torch.nn.functional.normalize(second, dim=-1, eps=1e-6)
    return torch.stack([first, second, torch.linalg.cross(first, second)], -1)
