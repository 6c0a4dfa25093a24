"""Walls around a bin: what stands beyond it is replaced, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture(scope="module")
def study(load_benchmark, run_folder, debug_shards):
    return load_benchmark("surroundings").Study(run_folder, debug_shards, 2)


@pytest.mark.parametrize("wall", [-0.1, 0.3])
def test_a_wall_stands_beyond_the_bin_and_hides_no_instance(study, wall):
    view = study.dataset[study.frames[0]]
    depth, replaced = study.behind_a_wall(view, wall), study.behind_a_wall(view, wall) != view.depth
    assert replaced.any()
    assert not replaced[view.instance_id > 0].any()
    median = np.median(study.dataset.header.object.centers(view.instances.cam_from_obj)[:, 2])
    np.testing.assert_allclose(depth[replaced], median + wall, rtol=1e-6)


def test_as_rendered_nothing_has_moved(study):
    ap, moved = study.row(None)
    assert 0.0 <= ap <= 1.0 and moved == 0.0
