"""gt.json and preds.json: exact round trips, and one sentence for whatever is wrong."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from evalkit import (
    InputError,
    average_precision,
    read_ground_truth,
    read_predictions,
    write_ground_truth,
    write_predictions,
)
from evalkit.geometry.camera import Camera
from evalkit.geometry.poses import from_rotation_translation, invert

CAMERA = Camera(640, 480, 600.0, 601.0, 319.5, 239.5)
JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-10, 10**400), st.floats(), st.text(max_size=5), st.just([]), st.just({}),
    st.just([[[]]]), st.lists(st.floats(), max_size=4), st.just({"R": 1}), st.just([None]),
)  # fmt: skip


@pytest.fixture
def documents(plain_model, make_crowd, tmp_path):
    """A folder with a valid gt.json and preds.json."""
    predictions, truth = make_crowd(plain_model, 0)
    truth = replace(truth, images=[replace(image, camera=CAMERA) for image in truth.images])
    write_ground_truth(tmp_path / "gt.json", truth)
    write_predictions(tmp_path / "preds.json", predictions)
    return tmp_path


def test_documents_come_back_bit_for_bit(symmetric_model, make_crowd, tmp_path):
    predictions, truth = make_crowd(symmetric_model, 1)
    truth = replace(truth, images=[replace(image, camera=CAMERA) for image in truth.images])
    write_ground_truth(tmp_path / "gt.json", truth)
    write_predictions(tmp_path / "preds.json", predictions)
    truth_read, predictions_read = read_ground_truth(tmp_path / "gt.json"), read_predictions(tmp_path / "preds.json")
    for one, other in zip(truth.images, truth_read.images, strict=True):
        assert (one.id, one.camera) == (other.id, other.camera)
        np.testing.assert_array_equal(one.cam_from_obj, other.cam_from_obj)
        np.testing.assert_array_equal(one.visibility, other.visibility)
    for one, other in zip(predictions.images, predictions_read.images, strict=True):
        assert (one.id, one.time_s) == (other.id, other.time_s)
        np.testing.assert_array_equal(one.cam_from_obj, other.cam_from_obj)
        np.testing.assert_array_equal(one.score, other.score)
    before, after = average_precision(predictions, truth), average_precision(predictions_read, truth_read)
    assert before.to_json()["curve"] == after.to_json()["curve"]


def test_the_same_content_is_the_same_bytes(documents):
    before = (documents / "gt.json").read_bytes()
    write_ground_truth(documents / "gt.json", read_ground_truth(documents / "gt.json"))
    assert (documents / "gt.json").read_bytes() == before


def change(folder, name, edit):
    document = json.loads((folder / name).read_text())
    image = next(i for i in document["images"] if len(i.get("hypotheses", i.get("instances"))) > 2)
    edit(document, image, image.get("hypotheses", image.get("instances")))
    (folder / name).write_text(json.dumps(document))
    return folder / name, image.get("id")


def scaled(rows, factor):
    rows[1]["R"] = (np.array(rows[1]["R"]) * factor).tolist()


def in_mm(document, field):
    document[field] = (1e3 * np.array(document[field])).tolist()


FAULTS = {
    "no format": (lambda d, i, r: d.pop("format"), ["format"]),
    "another format": (lambda d, i, r: d.update(format="coco"), ["format", "coco"]),
    "images missing": (lambda d, i, r: d.pop("images"), ["images"]),
    "images no list": (lambda d, i, r: d.update(images={}), ["images"]),
    "image no object": (lambda d, i, r: d["images"].insert(0, 3), ["image 0"]),
    "id missing": (lambda d, i, r: i.pop("id"), ["id"]),
    "id a number": (lambda d, i, r: i.update(id=3), ["id"]),
    "duplicate id": (lambda d, i, r: d["images"].append(copy.deepcopy(i)), ["twice", "ID"]),
    "rows no list": (lambda d, i, r: i.update(hypotheses=4, instances=4), ["ID", "must be a list"]),
    "row no object": (lambda d, i, r: r.__setitem__(1, []), ["ID", "1"]),
    "R missing": (lambda d, i, r: r[1].pop("R"), ["ID", "1", "'R'"]),
    "R of 9": (lambda d, i, r: r[1].update(R=[1, 0, 0, 0, 1, 0, 0, 0, 1]), ["ID", "1", "'R'"]),
    "R of text": (lambda d, i, r: r[1].update(R=[["1", "0", "0"]] * 3), ["ID", "1", "'R'"]),
    "R NaN": (lambda d, i, r: r[1].update(R=[[float("nan")] * 3] * 3), ["ID", "1", "'R'", "finite"]),
    "R scaled": (lambda d, i, r: scaled(r, 1.01), ["ID", "1", "'R'", "rotation"]),
    "R reflected": (lambda d, i, r: scaled(r, -1.0), ["ID", "1", "'R'", "rotation"]),
    "t missing": (lambda d, i, r: r[2].pop("t"), ["ID", "2", "'t'"]),
    "t of 2": (lambda d, i, r: r[2].update(t=[0, 0]), ["ID", "2", "'t'"]),
    "t a column": (lambda d, i, r: r[2].update(t=[[0], [0], [1]]), ["ID", "2", "'t'"]),
    "t infinite": (lambda d, i, r: r[2].update(t=[0, 0, float("inf")]), ["ID", "2", "'t'", "finite"]),
    "t in mm": (lambda d, i, r: r[2].update(t=[0, 0, 812.0]), ["ID", "2", "'t'", "millimeters"]),
    "another unit": (lambda d, i, r: d.update(units="mm"), ["units", "mm"]),
    "an image in another unit": (lambda d, i, r: i.update(unit="Millimeter"), ["ID", "unit", "Millimeter"]),
    "frame unknown": (lambda d, i, r: d.update(frame="robot"), ["frame", "robot"]),
}  # fmt: skip
GT_FAULTS = {
    "no images": (lambda d, i, r: d.update(images=[]), ["images", "empty"]),
    "object missing": (lambda d, i, r: d.pop("object"), ["object"]),
    "object without threshold": (lambda d, i, r: d["object"].pop("threshold"), ["threshold"]),
    "object in another unit": (lambda d, i, r: d["object"].update(unit="inch"), ["object", "inch"]),
    "threshold in mm": (lambda d, i, r: d["object"].update(threshold=1e3 * d["object"]["threshold"]), ["threshold"]),
    "lambda in mm": (lambda d, i, r: in_mm(d["object"], "lambda"), ["lambda"]),
    "lambda of nothing": (lambda d, i, r: d["object"].update({"lambda": np.zeros((3, 3)).tolist()}), ["lambda"]),
    "vertices in mm": (lambda d, i, r: d["object"].update(vertices=[[10.0, 0, 0]]), ["vertices"]),
    "visibility missing": (lambda d, i, r: r[0].pop("visibility"), ["ID", "0", "visibility"]),
    "visibility in percent": (lambda d, i, r: r[0].update(visibility=80), ["ID", "visibility"]),
    "camera of text": (lambda d, i, r: i.update(camera="pinhole"), ["ID", "camera"]),
    "camera without fx": (lambda d, i, r: i["camera"].pop("fx"), ["ID", "camera", "fx"]),
    "camera with a list": (lambda d, i, r: i["camera"].update(fx=[1]), ["ID", "camera", "fx"]),
}
PREDS_FAULTS = {
    "object named by a number": (lambda d, i, r: d.update(object={"name": 7}), ["object", "name"]),
    "diameter negative": (lambda d, i, r: d.update(object={"name": "x", "diameter": -1}), ["diameter"]),
    "score missing": (lambda d, i, r: r[0].pop("score"), ["ID", "0", "score"]),
    "score NaN": (lambda d, i, r: r[0].update(score=float("nan")), ["ID", "0", "score", "finite"]),
    "score of text": (lambda d, i, r: r[0].update(score="0.5"), ["ID", "0", "score"]),
    "time negative": (lambda d, i, r: i.update(time_s=-1), ["ID", "time_s"]),
}


@pytest.mark.parametrize("fault", FAULTS | GT_FAULTS)
def test_a_faulty_ground_truth_gets_one_sentence_with_file_image_and_field(documents, fault):
    edit, words = (FAULTS | GT_FAULTS)[fault]
    path, name = change(documents, "gt.json", edit)
    with pytest.raises(InputError) as caught:
        read_ground_truth(path)
    assert all(word.replace("ID", str(name)) in str(caught.value) for word in [str(path), *words])


@pytest.mark.parametrize("fault", FAULTS | PREDS_FAULTS)
def test_faulty_predictions_get_one_sentence_with_file_image_and_field(documents, fault):
    edit, words = (FAULTS | PREDS_FAULTS)[fault]
    path, name = change(documents, "preds.json", edit)
    with pytest.raises(InputError) as caught:
        read_predictions(path)
    assert all(word.replace("ID", str(name)) in str(caught.value) for word in [str(path), *words])


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "null", '{"format": "binpose-preds/1"', "\xff\xfe", "[" * 10**6, '{"a":' * 10**6]
)
def test_what_is_no_document_gets_one_sentence(tmp_path, text):
    path = tmp_path / "preds.json"
    path.write_bytes(text.encode("latin-1"))
    for read in (read_predictions, read_ground_truth):
        with pytest.raises(InputError, match=r"preds\.json"):
            read(path)


def test_a_byte_order_mark_is_let_pass(documents):
    path = documents / "preds.json"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_predictions(path).images


def test_a_mesh_whose_origin_lies_far_off_scores_like_any_other(plain_model, make_crowd, tmp_path):
    predictions, truth = make_crowd(plain_model, 0)
    before = average_precision(predictions, truth).ap
    model = plain_model.with_origin([200.0, -300.0, 100.0])
    moved = from_rotation_translation(np.eye(3), [-200.0, 300.0, -100.0])

    def far(images):
        return [replace(image, cam_from_obj=image.cam_from_obj @ invert(moved)) for image in images]

    write_ground_truth(tmp_path / "gt.json", replace(truth, object=model, images=far(truth.images)))
    reference = {"name": model.name, "box_center": (plain_model.centroid + moved[:3, 3]).tolist()}
    write_predictions(tmp_path / "preds.json", replace(predictions, object=reference, images=far(predictions.images)))
    truth, predictions = read_ground_truth(tmp_path / "gt.json"), read_predictions(tmp_path / "preds.json")
    assert average_precision(predictions, truth).ap == pytest.approx(before, abs=1e-6)


def test_published_rounding_is_accepted(documents):
    def round_off(document, image, rows):
        for row in rows:
            row["R"] = np.round(row["R"], 3).tolist()

    path, _ = change(documents, "preds.json", round_off)
    assert read_predictions(path).images


def test_unknown_fields_and_an_absent_camera_are_let_pass(documents):
    def extend(document, image, rows):
        document["comment"] = {"instances": [1, 2], "id": 5}
        image.pop("camera")
        rows[0]["segmentation"] = [1, 2, 3]

    path, name = change(documents, "gt.json", extend)
    assert next(image for image in read_ground_truth(path).images if image.id == name).camera is None


def damage(text, data):
    """Replace, delete or cut something at a random place of a JSON text."""
    if data.draw(st.booleans()):
        cut = data.draw(st.integers(0, len(text)))
        return text[:cut] + data.draw(st.text(max_size=3)) + text[cut + data.draw(st.integers(0, 30)) :]
    document = json.loads(text)
    holder, key = document, data.draw(st.sampled_from(sorted(document)))
    while isinstance(holder[key], dict | list) and holder[key] and data.draw(st.integers(0, 4)):
        holder = holder[key]
        key = data.draw(st.sampled_from(sorted(holder) if isinstance(holder, dict) else range(len(holder))))
    if data.draw(st.booleans()):
        holder[key] = data.draw(JUNK)
    else:
        del holder[key]
    return json.dumps(document)


def fuzz(folder, data):
    """Damage one of the two documents: reading and scoring must succeed or raise one InputError that names the file."""
    name = data.draw(st.sampled_from(["gt.json", "preds.json"]))
    (folder / "fuzzed").mkdir(exist_ok=True)
    path = folder / "fuzzed" / name
    path.write_text(damage((folder / name).read_text(), data), encoding="utf-8", errors="surrogatepass")
    paths = {"gt.json": folder / "gt.json", "preds.json": folder / "preds.json", name: path}
    try:
        score = average_precision(read_predictions(paths["preds.json"]), read_ground_truth(paths["gt.json"])).ap
        assert 0 <= score <= 1
    except InputError as error:
        assert str(path) in str(error)
        assert len(str(error)) < 600


RELAXED = {"suppress_health_check": list(HealthCheck), "deadline": None}


@settings(max_examples=400, **RELAXED)
@given(data=st.data())
def test_fuzzed_documents_raise_nothing_but_input_errors(documents, data):
    fuzz(documents, data)


@pytest.mark.slow
@settings(max_examples=10_000, **RELAXED)
@given(data=st.data())
def test_ten_thousand_fuzzed_documents_raise_nothing_but_input_errors(documents, data):
    fuzz(documents, data)
