"""bop24 gives the figures that BOP's own toolkit gave on the same simulated estimates."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

RECORDED = json.loads(Path(__file__).with_name("bop_toolkit_figures.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def simulation(load_benchmark):
    return load_benchmark("bop_toolkit")


@pytest.mark.parametrize("seed", RECORDED)
def test_every_score_is_the_toolkits_to_the_last_digit(simulation, tmp_path, seed):
    simulation.simulate(tmp_path, int(seed))
    assert simulation.by_evalkit(tmp_path) == pytest.approx(RECORDED[seed], rel=0, abs=1e-12)
