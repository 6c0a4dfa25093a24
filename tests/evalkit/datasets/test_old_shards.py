"""Shards of the first schema: read as they are, with the geometric share counted; never mixed with new ones."""

from __future__ import annotations

import shutil
from dataclasses import fields

import numpy as np
import pytest

from evalkit.datasets.ground_truth import read_ground_truth
from evalkit.datasets.scene import Instances
from evalkit.datasets.shard_folder import ShardDataset, shard_name
from evalkit.errors import InputError


@pytest.fixture(scope="module")
def new(run_command, tmp_path_factory):
    """Two shards whose depth has holes."""
    out = tmp_path_factory.mktemp("new") / "shards"
    done = run_command(
        "simgen", "build", "--object", "bunny", "--preset", "debug", "--sensor", "stereo", "--scenes", 2, "--views", 2,
        "--shard-scenes", 1, "--instances", "3-3", "--workers", 1, "-o", out,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def old(new, as_schema_1, tmp_path):
    folder = tmp_path / "old"
    shutil.copytree(new, folder)
    as_schema_1(folder)
    return folder


def test_old_shards_say_of_every_instance_what_new_ones_say(new, old):
    before, after = ShardDataset(old), ShardDataset(new)
    assert before.reader(0).schema == "binpose-shard/1"
    lost = 0
    for frame in range(len(after)):
        reader, number = before.locate(frame)
        for labels in (before[frame].instances, reader.labels(number)):
            for name in (field.name for field in fields(Instances)):
                np.testing.assert_array_equal(getattr(labels, name), getattr(after[frame].instances, name), name)
        lost += (after[frame].instances.pixels_geometric - after[frame].instances.pixels_returned).sum()
    assert lost > 0


def test_ground_truth_of_old_shards_is_that_of_new_ones_and_says_what_was_counted(new, old):
    before, after = read_ground_truth(old), read_ground_truth(new)
    assert any("binpose-shard/1" in remark and "counted" in remark for remark in before.remarks)
    assert before.share == after.share == "geometric" and not after.remarks
    for one, other in zip(before.images, after.images, strict=True):
        np.testing.assert_array_equal(one.visibility, other.visibility)
        np.testing.assert_array_equal(one.other_visibility, other.other_visibility)
    assert not read_ground_truth(old, visibility="returned").remarks, "which they hold"


def test_shards_of_both_schemas_are_refused_in_one_folder(new, old):
    shutil.copy(new / shard_name(1), old)
    with pytest.raises(InputError, match=r"shard-00001\.h5: is of schema binpose-shard/2.*use shards of one schema"):
        ShardDataset(old)
