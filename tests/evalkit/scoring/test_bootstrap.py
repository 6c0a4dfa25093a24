"""The bootstrap: intervals that hold the figure, and differences told from chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evalkit import InputError, average_precision
from evalkit.scoring.bootstrap import compare, intervals, scene_numbers


def weighted(result, weights):
    return result.area(result.steps.curve(np.asarray(weights, float)))


@pytest.mark.parametrize("protocol", ["sileane", "coco"])
def test_weights_count_images_as_often_as_if_they_were_repeated(symmetric_model, make_crowd, protocol):
    predictions, truth = make_crowd(symmetric_model, 3)
    result = average_precision(predictions, truth, protocol=protocol)
    times = [2, 0, 1, 3, 1, 1]
    repeated = [
        replace(
            document,
            images=[
                replace(image, id=f"{image.id}x{k}")
                for image in document.images
                for k in range(times[int(image.id[1:])])
            ],
        )
        for document in (predictions, truth)
    ]
    expected = average_precision(*repeated, protocol=protocol).ap
    assert weighted(result, times) == pytest.approx(expected, abs=1e-12)
    assert weighted(result, np.ones(6)) == result.ap


def test_intervals_hold_the_figures_and_are_reproducible(plain_model, make_crowd):
    result = average_precision(*make_crowd(plain_model, 5, images=30))
    found = intervals(result, 200)
    for key in ("ap", "map", "best_f1"):
        assert found[key].low <= getattr(result, key) <= found[key].high
        assert 0 < found[key].high - found[key].low < 1
    assert found == intervals(result, 200)


def test_more_scenes_make_narrower_intervals(plain_model, make_crowd):
    widths = []
    for images in (10, 160):
        found = intervals(average_precision(*make_crowd(plain_model, 5, images=images)), 200)["ap"]
        widths.append(found.high - found.low)
    assert widths[1] < widths[0] / 2


def test_views_of_a_scene_are_drawn_together():
    assert scene_numbers(["000001-000", "000001-016", "000002-000", "bunny_3_070"]).tolist() == [0, 0, 1, 2]


def test_a_method_is_not_better_than_itself_and_worse_when_spoiled(plain_model, make_crowd):
    predictions, truth = make_crowd(plain_model, 5, images=60)
    result = average_precision(predictions, truth, protocol="coco")
    same = compare(result, result, 100)
    assert (same.difference.value, same.difference.low, same.difference.high, same.better) == (0, 0, 0, 0)
    fewer = [replace(image, cam_from_obj=image.cam_from_obj[:0], score=image.score[:0]) for image in predictions.images]
    fewer[::2] = predictions.images[::2]
    spoiled = compare(result, average_precision(replace(predictions, images=fewer), truth, protocol="coco"), 100)
    assert spoiled.difference.high < 0
    assert spoiled.better == 0


def test_results_on_other_images_are_not_compared(plain_model, make_crowd):
    results = [average_precision(*make_crowd(plain_model, 5, images=count)) for count in (6, 7)]
    with pytest.raises(InputError, match="same images"):
        compare(*results, 10)
    with pytest.raises(InputError, match="bootstrap"):
        intervals(results[0], 0)
