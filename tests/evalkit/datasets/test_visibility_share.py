"""Ground truth holds both shares of visibility, says which comes first, and is scored by the one that is asked for."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from evalkit.datasets.documents import PredictionImage, Predictions, read_ground_truth, write_ground_truth
from evalkit.datasets.visibility_share import with_share
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.scoring.detection_ap import detection_ap
from evalkit.scoring.evaluation import average_precision

CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)


@pytest.fixture
def truth(plain_model, make_crowd):
    """Of each instance, the sensor returned half of what is visible."""
    _, truth = make_crowd(plain_model, 0)
    images = [replace(image, other_visibility=image.visibility / 2) for image in truth.images]
    return replace(truth, images=images, share="geometric")


@pytest.fixture
def predictions(truth):
    """Only what is mostly returned is found."""
    images = []
    for image in truth.images:
        seen = image.other_visibility >= 0.4
        images.append(PredictionImage(image.id, image.cam_from_obj[seen], image.visibility[seen]))
    return Predictions(truth.object.name, images)


def test_a_document_keeps_both_shares_and_which_is_first(truth, tmp_path):
    for share in ("geometric", "returned"):
        write_ground_truth(tmp_path / "gt.json", with_share(truth, share))
        back = read_ground_truth(tmp_path / "gt.json")
        assert back.share == share
        for one, other in zip(back.images, truth.images, strict=True):
            shares = {share: one.visibility, "geometric" if share == "returned" else "returned": one.other_visibility}
            np.testing.assert_array_equal(shares["geometric"], other.visibility)
            np.testing.assert_array_equal(shares["returned"], other.other_visibility)


def test_to_ask_for_a_share_and_then_the_other_is_to_ask_for_the_other(truth):
    there_and_back = with_share(with_share(truth, "returned"), "geometric")
    for one, other in zip(there_and_back.images, truth.images, strict=True):
        np.testing.assert_array_equal(one.visibility, other.visibility)
        np.testing.assert_array_equal(one.other_visibility, other.other_visibility)


def test_the_share_that_is_asked_for_decides_what_is_to_be_found_and_the_score_says_so(truth, predictions):
    for share in ("geometric", "returned"):
        asked = with_share(truth, share)
        result = average_precision(predictions, truth, visibility=share, min_visibility=0.4)
        wanted = np.concatenate([image.visibility for image in asked.images]) >= 0.4
        assert result.counts["instances_to_find"] == wanted.sum()
        assert f"({share} share)" in result.protocol and result.to_json()["visibility"] == share
        assert result.ap == average_precision(predictions, asked, min_visibility=0.4).ap
    assert average_precision(predictions, truth, visibility="returned", min_visibility=0.4).ap == 1.0
    assert average_precision(predictions, truth, min_visibility=0.4).ap < 1.0, "geometric comes first"


def test_bops_score_goes_by_the_geometric_share_where_it_is_known(truth, predictions):
    seen = replace(truth, images=[replace(image, camera=CAMERA) for image in truth.images])
    for first in ("geometric", "returned"):
        both = with_share(seen, first)
        assert detection_ap(predictions, both).visibility == "geometric"
        assert "geometric share" in detection_ap(predictions, both).protocol
    one = replace(seen, images=[replace(image, other_visibility=None) for image in seen.images], share="returned")
    assert detection_ap(predictions, one).visibility == "returned"


def test_a_document_that_does_not_say_its_share_is_scored_and_the_score_says_so(truth, predictions, tmp_path):
    write_ground_truth(tmp_path / "gt.json", replace(truth, share=None))
    back = read_ground_truth(tmp_path / "gt.json")
    assert back.share is None and back.images[0].other_visibility is None
    assert "(share not stated)" in average_precision(predictions, back).protocol
    with pytest.raises(InputError, match=r"gt\.json: does not say which share.*leave out --visibility"):
        average_precision(predictions, back, visibility="geometric")


def test_a_share_that_a_document_lacks_is_refused(truth, predictions):
    lacking = [truth.images[0], *(replace(image, other_visibility=None) for image in truth.images[1:])]
    with pytest.raises(InputError, match="holds the geometric share alone, and returned visibility was asked for"):
        average_precision(predictions, replace(truth, images=lacking), visibility="returned")
    with pytest.raises(InputError, match="'visible' is not known"):
        average_precision(predictions, truth, visibility="visible")


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda d: d.update(visibility="seen"), "'visibility' must be"),
        (lambda d: row_of(d).update(visibility_returned=1.5), "between 0 and 1"),
        (lambda d: row_of(d).update(visibility_returned="half"), "'visibility_returned' must be a number"),
        (lambda d: row_of(d, -1).pop("visibility_returned"), "'visibility_returned' is missing"),
    ],
)
def test_a_wrong_share_is_named(truth, tmp_path, edit, words):
    path = tmp_path / "gt.json"
    write_ground_truth(path, truth)
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=words):
        read_ground_truth(path)


def row_of(document, row=0):
    """A row of the first image that has several."""
    return next(image["instances"] for image in document["images"] if len(image["instances"]) > 1)[row]
