"""The unit is decided by size, aloud, and the user's word stands above all."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.errors import InputError
from simgen.objects.units import METRES, POSSIBLE, USABLE, USUAL, check_size, decide_units

SIZES = np.geomspace(1e-7, 1e7, 57)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("unit", METRES)
def test_a_unit_that_is_given_is_used(unit: str, size: float) -> None:
    assert decide_units(unit, size, "stl", "x.stl")[0::2] == (unit, [])


@pytest.mark.parametrize("size", SIZES)
def test_a_usual_size_is_taken_in_silence_a_possible_one_with_a_warning_and_no_other_at_all(size: float) -> None:
    metres = [size * factor for factor in METRES.values()]
    if any(USUAL[0] <= side <= USUAL[1] for side in metres):
        unit, _, warnings = decide_units("auto", size, "stl", "x.stl")
        assert USUAL[0] <= size * METRES[unit] <= USUAL[1] and not warnings
    elif any(POSSIBLE[0] <= side <= POSSIBLE[1] for side in metres):
        unit, _, warnings = decide_units("auto", size, "stl", "x.stl")
        assert POSSIBLE[0] <= size * METRES[unit] <= POSSIBLE[1]
        assert len(warnings) == 1 and "--units" in warnings[0]
    else:
        with pytest.raises(InputError, match=r"x\.stl.*--units"):
            decide_units("auto", size, "stl", "x.stl")


def test_no_size_is_usual_in_both_units() -> None:
    assert USUAL[1] < USUAL[0] / METRES["mm"]


@pytest.mark.parametrize("size", [1e-3, 0.1, 120.0])
def test_gltf_is_in_metres_by_its_specification(size: float) -> None:
    assert decide_units("auto", size, "glb", "x.glb")[0] == "m"


@pytest.mark.parametrize("units", ["inch", "", "MM"])
def test_an_unknown_unit_is_refused(units: str) -> None:
    with pytest.raises(InputError, match="--units"):
        decide_units(units, 0.1, "stl", "x.stl")


@pytest.mark.parametrize("side", [USABLE[0] / 1.1, USABLE[1] * 1.1])
def test_what_cannot_be_simulated_is_refused(side: float) -> None:
    with pytest.raises(InputError, match="--scale"):
        check_size(side, "x.stl")


def test_an_unusual_size_is_told() -> None:
    assert check_size(0.1, "x.stl") == []
    assert len(check_size(5.0, "x.stl")) == 1
