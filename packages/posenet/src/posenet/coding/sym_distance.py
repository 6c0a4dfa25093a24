"""The Sym distance in torch, for losses and for telling hypotheses apart; evalkit's is the oracle in the tests.

For a finite group d^2 = |t1 - t2|^2 + min_g |(R1 - R2 g) Lambda|^2, and because |R Lambda| does not depend on R, the
second term is 2 tr(Lambda^2) - 2 max_g tr(Lambda^2 R1^T R2 g): one small matrix product for all group elements.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from evalkit.objects.symmetry import Symmetry


class SymDistance(nn.Module):
    """Distances in meters between poses given as rotations (..., 3, 3) and positions of the centroid (..., 3)."""

    elements: Tensor
    axes: Tensor

    def __init__(self, symmetry: Symmetry, lam: NDArray[np.float64]) -> None:
        """`symmetry` and `lam` (3, 3), the square root of the surface covariance, in one and the same frame."""
        super().__init__()
        self.kind = symmetry.kind
        squared = lam @ lam
        weighted = np.swapaxes(symmetry.rotations @ squared, -1, -2).reshape(-1, 9)
        self.register_buffer("elements", torch.as_tensor(weighted, dtype=torch.float32), persistent=False)
        axes = symmetry.rotations @ symmetry.axis
        self.register_buffer("axes", torch.as_tensor(axes, dtype=torch.float32), persistent=False)
        self.trace = float(np.trace(squared))
        self.scale_squared = symmetry.revolution_scale(lam) ** 2

    def rotation_squared(self, rotation_a: Tensor, rotation_b: Tensor) -> Tensor:
        """The rotational part of d^2, in square meters, for broadcastable rotations (..., 3, 3) -> (...)."""
        if self.kind == "sphere":
            return (rotation_a[..., 0, 0] - rotation_b[..., 0, 0]) * 0.0
        relative = rotation_a.transpose(-1, -2) @ rotation_b
        if self.kind == "revolution":
            cosine = (relative @ self.axes.T).mul(self.axes[0][:, None]).sum(-2).amax(-1)
            return 2.0 * self.scale_squared * (1.0 - cosine).clamp(min=0.0)
        overlap = (relative.flatten(-2) @ self.elements.T).amax(-1)
        return (2.0 * self.trace - 2.0 * overlap).clamp(min=0.0)

    def pairwise(self, rotation: Tensor, center: Tensor) -> Tensor:
        """All distances within sets of n poses: rotation (..., n, 3, 3), center (..., n, 3) -> (..., n, n)."""
        return self.between(rotation, center, rotation, center)

    def between(self, rotation_a: Tensor, center_a: Tensor, rotation_b: Tensor, center_b: Tensor) -> Tensor:
        """All distances from n poses, (..., n, 3, 3) and (..., n, 3), to m poses -> (..., n, m)."""
        turn = self.rotation_squared(rotation_a[..., :, None, :, :], rotation_b[..., None, :, :, :])
        shift = (center_a[..., :, None, :] - center_b[..., None, :, :]).square().sum(-1)
        return (turn + shift).sqrt()
