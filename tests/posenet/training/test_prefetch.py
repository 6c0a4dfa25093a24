"""What other processes make ahead is what would have been made at the time."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from evalkit.errors import InputError
from posenet.config import preset
from posenet.training.batches import Batches
from posenet.training.dataset import Frames
from posenet.training.prefetch import Prefetch
from posenet.training.rank import ALONE


def _square(number: int) -> tuple[int, int]:
    if number == 13:
        raise ValueError("thirteen")
    if number == 17:
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2, os.getpid()


@pytest.fixture()
def ahead() -> Iterator[Prefetch[tuple[int, int]]]:
    prefetch = Prefetch(_square, ahead=3, workers=2)
    yield prefetch
    prefetch.close()


def test_items_come_in_the_order_asked_for_and_are_made_elsewhere(ahead: Prefetch[tuple[int, int]]) -> None:
    numbers = [0, 1, 2, 3, 7, 4, 5]  # with a jump and back
    made = [ahead[number] for number in numbers]
    assert [square for square, _ in made] == [number**2 for number in numbers]
    assert os.getpid() not in {process for _, process in made}


def test_an_error_comes_when_its_item_is_asked_for(ahead: Prefetch[tuple[int, int]]) -> None:
    assert ahead[11][0] == 121 and ahead[12][0] == 144
    with pytest.raises(ValueError, match="thirteen"):
        ahead[13]


def test_a_killed_process_is_a_sentence(ahead: Prefetch[tuple[int, int]]) -> None:
    with pytest.raises(InputError, match="was killed"):
        ahead[17]


def test_batches_made_ahead_are_those_made_in_turn(debug_shards: Path) -> None:
    batches = Batches(Frames(debug_shards), np.arange(6), preset("small").train, 0, ALONE)
    ahead = Prefetch(batches.packed, ahead=4, workers=2)
    cpu = torch.device("cpu")
    for step in range(4):
        here, elsewhere = batches.load(step, cpu), ahead[step].unpacked(cpu)
        assert torch.equal(here.depth, elsewhere.depth) and here.seeds == elsewhere.seeds
        for mine, other in zip(here[2:5], elsewhere[2:5], strict=True):
            assert all(torch.equal(a, b) for a, b in zip(mine, other, strict=True))
    ahead.close()
