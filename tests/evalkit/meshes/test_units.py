"""One policy of units: the user's word, then the file's, then its size, and never in silence where it is doubtful."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.meshes.units import CHOICES, LIKELY, METERS, POSSIBLE, USABLE, USUAL, check_size, decide_units

SIZES = np.geomspace(1e-7, 1e7, 57)
GUESSED = ("m", "mm")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("unit", CHOICES[1:])
def test_a_unit_that_is_given_is_used(unit: str, size: float) -> None:
    assert decide_units(unit, size, "stl", "x.stl")[0::2] == (unit, [])


@pytest.mark.parametrize("size", SIZES)
def test_the_unit_that_gives_a_usual_size_is_taken_then_a_possible_one_and_else_none(size: float) -> None:
    for low, high in (USUAL, POSSIBLE):
        fitting = [unit for unit in GUESSED if low <= size * METERS[unit] <= high]
        if fitting:
            assert decide_units("auto", size, "stl", "x.stl")[0] in fitting
            return
    with pytest.raises(InputError, match=r"x\.stl.*--units"):
        decide_units("auto", size, "stl", "x.stl")


@pytest.mark.parametrize("size", np.geomspace(POSSIBLE[0], POSSIBLE[1] / METERS["mm"], 60))
def test_a_size_that_another_unit_makes_likely_is_never_read_in_silence(size: float) -> None:
    unit, _, warnings = decide_units("auto", size, "stl", "x.stl")
    others = [u for u in CHOICES[1:] if u != unit and LIKELY[0] <= size * METERS[u] <= LIKELY[1]]
    usual = USUAL[0] <= size * METERS[unit] <= USUAL[1]
    assert bool(warnings) == (bool(others) or not usual)
    assert all(f"--units {other}" in warnings[0] for other in others)


@pytest.mark.parametrize(("size", "truth"), [(0.8, "inch"), (0.39, "inch"), (12.0, "cm"), (8.0, "inch")])
def test_parts_in_inches_and_centimeters_get_a_warning_that_names_their_unit(size: float, truth: str) -> None:
    assert f"--units {truth}" in " ".join(decide_units("auto", size, "stl", "part.stl")[2])


@pytest.mark.parametrize("size", [50.0, 120.0, 380.0, 0.1, 0.15])
def test_common_parts_in_millimeters_or_meters_are_read_without_a_warning(size: float) -> None:
    assert decide_units("auto", size, "stl", "x.stl")[2] == []


def test_no_size_is_usual_in_both_units_that_are_guessed() -> None:
    assert USUAL[1] < USUAL[0] / METERS["mm"]


@pytest.mark.parametrize("size", [1e-3, 0.1, 120.0])
def test_gltf_is_in_meters_by_its_specification(size: float) -> None:
    assert decide_units("auto", size, "glb", "x.glb")[0::2] == ("m", [])


@pytest.mark.parametrize("stated", METERS)
def test_what_a_file_states_is_taken_whatever_its_size_unless_the_user_says_otherwise(stated: str) -> None:
    assert decide_units("auto", 8.0, "3mf", "x.3mf", stated)[0::2] == (stated, [])
    for unit in CHOICES[1:]:
        taken, _, warnings = decide_units(unit, 8.0, "3mf", "x.3mf", stated)
        assert taken == unit and bool(warnings) == (unit != stated)


@pytest.mark.parametrize("extension", ["step", "stp"])
@pytest.mark.parametrize("unit", CHOICES[1:])
def test_a_step_file_is_read_in_its_own_unit_only(extension: str, unit: str) -> None:
    assert decide_units("auto", 0.04, extension, "x.step", "m")[0] == "m"
    with pytest.raises(InputError, match=rf"x\.step.*leave --units {unit} out"):
        decide_units(unit, 0.04, extension, "x.step", "m")


@pytest.mark.parametrize("units", ["foot", "", "MM"])
def test_an_unknown_unit_is_refused(units: str) -> None:
    with pytest.raises(InputError, match="--units"):
        decide_units(units, 0.1, "stl", "x.stl")


@pytest.mark.parametrize("side", [USABLE[0] / 1.1, USABLE[1] * 1.1])
def test_what_cannot_be_simulated_is_refused(side: float) -> None:
    with pytest.raises(InputError, match="--scale"):
        check_size(side, "x.stl")


def test_an_unusual_size_gets_a_warning() -> None:
    assert check_size(0.1, "x.stl") == []
    assert len(check_size(5.0, "x.stl")) == 1
