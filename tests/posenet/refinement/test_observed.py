"""What a depth image shows, in one pass, is what the network's own normals say."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posenet.network.depth_input import surface_normals
from posenet.refinement.observed import observed

INTRINSICS = np.array([210.0, 220.0, 31.2, 23.7])


@pytest.mark.parametrize("shape", [(48, 64), (1, 9), (9, 1), (1, 1)])
def test_depth_and_normals_are_those_of_the_plain_formulas(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.4, 0.6, shape).astype(np.float32)
    depth[rng.random(shape) < 0.3] = 0.0
    found = observed(depth, INTRINSICS)
    plain = surface_normals(torch.from_numpy(depth)[None], torch.from_numpy(INTRINSICS).float()[None])[0]
    np.testing.assert_array_equal(found[..., 0], depth)
    np.testing.assert_allclose(found[..., 1:], plain.permute(1, 2, 0).numpy(), atol=1e-5)
    assert found.dtype == np.float32 and found.flags.c_contiguous
