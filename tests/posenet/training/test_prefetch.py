"""What is made ahead is what would have been made at the time."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from posenet.config import preset
from posenet.training.batches import Batches
from posenet.training.dataset import Frames
from posenet.training.prefetch import Prefetch
from posenet.training.rank import ALONE


def test_each_number_is_made_once_and_in_any_thread_the_same() -> None:
    made, lock = [], threading.Lock()

    def make(number: int) -> int:
        with lock:
            made.append(number)
        return number * number

    ahead = Prefetch(make, 3)
    assert [ahead[number] for number in range(20)] == [number**2 for number in range(20)]
    ahead.close()
    assert sorted(set(made)) == sorted(made)


def test_a_jump_gives_what_is_asked_for() -> None:
    ahead = Prefetch(str, 2)
    assert [ahead[number] for number in (0, 7, 3, 4)] == ["0", "7", "3", "4"]


def test_an_error_comes_when_its_item_is_asked_for() -> None:
    def make(number: int) -> int:
        if number == 2:
            raise ValueError("two")
        return number

    ahead = Prefetch(make, 3)
    assert [ahead[0], ahead[1]] == [0, 1]
    with pytest.raises(ValueError, match="two"):
        ahead[2]


def test_batches_made_ahead_are_those_made_in_turn(debug_shards: Path) -> None:
    def batches() -> Batches:
        return Batches(Frames(debug_shards), np.arange(6), preset("small").train, 0, ALONE)

    one, other = batches(), batches()
    ahead = Prefetch(other._made, 4)
    for step in range(6):
        assert torch.equal(one.load(step, torch.device("cpu")).depth, ahead[step].depth)
