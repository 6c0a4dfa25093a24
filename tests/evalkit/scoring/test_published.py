"""The published tables: that they are those of the papers, and that nothing of ours is ever called comparable."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest
from click.testing import CliRunner

from evalkit import average_precision
from evalkit.commands.cli import main
from evalkit.scoring import published
from evalkit.scoring.published import TABLES, closest_table, conditions


@pytest.fixture
def result(plain_model, make_crowd):
    predictions, truth = make_crowd(replace(plain_model, name="bunny"), 0)
    return average_precision(predictions, replace(truth, share="returned"), protocol="sileane-toolbox")


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.key)
def test_a_table_has_a_figure_for_every_method_and_object_and_says_where_it_is_from(table):
    assert all(len(values) == len(table.columns) for values in table.rows.values())
    assert all(0 < value < 1 for values in table.rows.values() for value in values)
    assert re.search(r"20\d\d|arXiv", table.source)


def test_the_figures_are_those_that_the_reference_folder_quotes(reference):
    quoted = (reference / "README.md").read_text(encoding="utf-8").split("## Published AP")[1]
    for table in TABLES[:3]:
        for values in table.rows.values():
            assert "/".join(f"{value:g}".lstrip("0").ljust(3, "0") for value in values) in quoted.replace("\n", " ")


def test_the_command_prints_every_table_aligned_and_with_its_source():
    printed = CliRunner().invoke(main, ["published"], catch_exceptions=False).output
    for table in TABLES:
        part = printed[printed.index(table.title) :]
        lines = part.splitlines()[2 : 3 + len(table.rows)]
        assert len({len(line) for line in lines}) == 1
        assert [line.split()[-1] for line in lines[1:]] == [published.figure(table, v[-1]) for v in table.rows.values()]
        assert table.source in part


def test_the_command_gives_the_same_as_json():
    tables = json.loads(CliRunner().invoke(main, ["published", "--json"], catch_exceptions=False).output)
    assert {table["key"]: table["rows"] for table in tables} == {
        table.key: {method: list(values) for method, values in table.rows.items()} for table in TABLES
    }


def test_the_images_are_never_said_to_be_the_same(result):
    first = conditions(TABLES[0], result)[0]
    assert (first.subject, first.holds) == ("images", None)


def test_images_of_our_simulation_are_said_to_differ(result):
    ids = [f"{number:06d}-000" for number in range(len(result.image_ids))]
    assert conditions(TABLES[0], replace(result, image_ids=ids))[0].holds is False


@pytest.mark.parametrize(
    ("change", "differs"),
    [
        ({"threshold": 0.05}, "criterion"),
        ({"criterion": "add", "protocol": "sileane"}, "criterion"),
        ({"min_visibility": 0.4}, "instances to find"),
        ({"visibility": "geometric"}, "instances to find"),
        ({"protocol": "coco"}, "protocol"),
        ({"max_results": 5}, "protocol"),
    ],
)
def test_other_rules_are_said_to_differ(result, change, differs):
    def holds(changed):
        return {condition.subject: condition.holds for condition in conditions(TABLES[0], changed)}

    assert holds(result)[differs] is True
    assert holds(replace(result, settings=replace(result.settings, **change)))[differs] is False


def test_a_sym_that_is_not_the_toolbox_s_own_is_not_said_to_be_the_same(result):
    ours = replace(result, settings=replace(result.settings, protocol="sileane"))
    assert {c.subject: c.holds for c in conditions(TABLES[0], ours)}["protocol"] is None


def test_another_object_is_said_to_differ(result):
    other = replace(result, object_name="gear")
    assert {c.subject: c.holds for c in conditions(TABLES[0], other)}["object"] is False


def test_the_table_shown_beside_a_run_is_that_of_its_criterion():
    assert [closest_table(name).key for name in ("sym", "add", "adds")] == ["sym", "add", "sym"]
