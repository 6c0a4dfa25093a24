"""When a curve of AP against minutes reaches a goal."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    ("curve", "minutes"),
    [
        ([], None),
        ([(5.0, 0.2), (10.0, 0.6)], None),
        ([(5.0, 0.96)], 5.0),
        ([(5.0, 0.85), (10.0, 0.95), (20.0, 0.9)], 10.0),
        ([(5.0, 0.9), (15.0, 1.0)], 10.0),
    ],
)
def test_a_goal_is_reached_on_the_line_between_two_trainings(load_benchmark, curve, minutes) -> None:
    assert load_benchmark("speed/speedrun").reached(curve, 0.95) == (
        None if minutes is None else pytest.approx(minutes)
    )


def test_the_table_has_a_row_for_each_training_and_says_who_reaches_the_goal(load_benchmark) -> None:
    curves = {"before": [(5.0, 0.5), (10.0, 0.6)], "after": [(5.0, 0.9), (10.0, 1.0)]}
    lines = list(load_benchmark("speed/speedrun").table(curves, 0.95))
    assert lines[2] == "| 5 | 0.500 | 0.900 |"
    assert lines[-1].strip() == "Minutes until AP 0.95: before never, after 7.5"
