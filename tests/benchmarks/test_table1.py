"""The paper's table on our own data: which cells are measured, kept and refused. The measuring itself is replaced."""

from __future__ import annotations

import json
import subprocess

import pytest

from evalkit.errors import InputError

FIGURES = {"value": 0.5, "low": 0.4, "high": 0.6, "images": 40, "seconds": 12.3}


@pytest.fixture(scope="module")
def table1(load_benchmark):
    load_benchmark("commands")
    return load_benchmark("table1")


@pytest.fixture
def measured(table1, monkeypatch):
    """The cells that were measured, in order; the fifth of a run that is `cut` ends it."""
    cells = []

    def measure(self, column, row):
        if len(cells) == 4 and "cut" not in cells:
            cells.append("cut")
            raise KeyboardInterrupt
        cells.append((column.title, row))
        return FIGURES

    monkeypatch.setattr(table1.Night, "measured", measure)
    return cells


def test_a_run_that_was_cut_off_measures_only_the_cells_that_are_missing(table1, measured, tmp_path, capsys):
    with pytest.raises(KeyboardInterrupt):
        table1.main(["-o", str(tmp_path)])
    table1.main(["-o", str(tmp_path)])
    cells = [cell for cell in measured if cell != "cut"]
    assert len(cells) == len(set(cells)) == len(table1.COLUMNS) * len(table1.ROWS)
    written = (tmp_path / "table1.md").read_text()
    assert written.count("0.500 [0.400, 0.600], 12 s") == len(cells)


def test_a_cell_half_written_when_the_machine_stopped_is_not_taken_for_one(table1, measured, tmp_path):
    night = table1.Night(tmp_path, 1, 1, "debug", 1.0)
    column = table1.COLUMNS[0]
    night.cell(column, "PPF")
    (cell,) = (tmp_path / "cells").iterdir()
    assert json.loads(cell.read_text()).items() >= FIGURES.items()  # it appears whole, or not at all
    night.cell(column, "PPF")
    assert measured == [(column.title, "PPF")]


def test_what_a_command_has_filled_stays_whatever_the_code_s_version(table1, monkeypatch, tmp_path):
    ran, failing = [], [True]

    def run(*words):
        ran.append(words)
        if failing:
            raise subprocess.CalledProcessError(2, words)

    monkeypatch.setattr(table1, "run", run)
    night, column = table1.Night(tmp_path, 1, 1, "debug", 1.0), table1.COLUMNS[0]
    with pytest.raises(subprocess.CalledProcessError):
        night.shards(column, "test")
    failing.clear()
    night.shards(column, "test")
    monkeypatch.setattr(table1, "code_version", lambda: "another")
    night.shards(column, "test")
    assert len(ran) == 2, "what failed is tried again, what is done is not"


def test_a_cell_that_fails_leaves_the_others_to_go_on(table1, monkeypatch, tmp_path, capsys):
    broken = [True]

    def measured(self, column, row):
        if column.mesh == "cup" and broken:
            raise subprocess.CalledProcessError(1, "simgen build")
        return FIGURES

    monkeypatch.setattr(table1.Night, "measured", measured)
    words = ["-o", str(tmp_path), "--rows", "PPF"]
    with pytest.raises(InputError, match="3 cells failed"):
        table1.main(words)
    text = (tmp_path / "table1.md").read_text()
    assert text.count("0.500 [") == 3 and "| failed |" in text
    broken.clear()
    table1.main(words)
    assert (tmp_path / "table1.md").read_text().count("0.500 [") == 6


def test_a_folder_begun_with_other_numbers_is_refused(table1, measured, tmp_path):
    table1.main(["-o", str(tmp_path), "--columns", "bunny, Sym", "--rows", "PPF"])
    with pytest.raises(InputError, match="begun with"):
        table1.main(["-o", str(tmp_path), "--minutes", "1"])


def test_the_paper_s_figures_stand_beside_ours(table1):
    bunny, crowd, domestic = (table1.COLUMNS[i] for i in (0, 4, 5))
    assert bunny.published("PPF+PP") == "0.37" and bunny.published("network") == "0.74"
    assert bunny.published("network without offset") == "0.49" and bunny.published("network, refined") == ""
    assert crowd.published("Linemod") == "0.32" and domestic.published("PPF") == "0.867"
