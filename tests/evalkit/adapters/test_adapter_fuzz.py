"""Whatever other people's files hold, the adapters read it or refuse it in one sentence; no traceback."""

from __future__ import annotations

import copy
import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evalkit import InputError, adapters

EXAMPLES = 100
MATRIX = "1 0 0 0.1\n0 1 0 0.2\n0 0 1 -0.8\n0 0 0 1\n"
IPA_ROW = "1,gear,0.1,0.1,1.2,1,0,0,0,1,0,0,0,1,0.5,0.5"
IPA_PARAMETERS = {
    "perspectiveAngle": 30, "resolution_big": 64, "resolutionX": 64, "resolutionY": 48,
    "pixelOffset_X_KoSyTopLeft": 0, "pixelOffset_Y_KoSyTopLeft": 8, "clip_start": 1, "clip_end": 2,
}  # fmt: skip
BOX_INFO = {"diameter": 173.2, **{f"min_{a}": -50.0 for a in "xyz"}, **{f"size_{a}": 100.0 for a in "xyz"}}
ODD = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 10**6), st.floats(), st.text(max_size=4), st.just([]), st.just({}),
    st.just(10**400), st.just([[1.0]]), st.lists(st.floats(-2, 2), min_size=9, max_size=9),
)  # fmt: skip


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """A small valid source of each format."""
    root = tmp_path_factory.mktemp("sources")
    scene = root / "bop" / "test" / "000001"
    (scene / "depth").mkdir(parents=True)
    cv2.imwrite(str(scene / "depth" / "000003.png"), np.full((48, 64), 900, np.uint16))
    symmetries = {"symmetries_discrete": [np.diag([-1.0, -1, 1, 1]).ravel().tolist()]}
    continuous = {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    row = {"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 900.0], "obj_id": 1}
    documents = {
        scene / "scene_gt.json": {"3": [row, row]},
        scene / "scene_gt_info.json": {"3": [{"visib_fract": 0.5}] * 2},
        scene / "scene_camera.json": {"3": {"cam_K": [60, 0, 31, 0, 60, 23, 0, 0, 1], "depth_scale": 1.0}},
        root / "bop" / "models" / "models_info.json": {"1": {**BOX_INFO, **symmetries, **continuous}},
        root / "ipa" / "parameter.json": IPA_PARAMETERS,
    }
    texts = {path: json.dumps(document) for path, document in documents.items()}
    texts[root / "bop" / "results.csv"] = (
        "scene_id,im_id,obj_id,score,R,t,time\n" + "1,3,1,0.5,1 0 0 0 1 0 0 0 1,0 0 900,0.2\n" * 2
    )
    texts[root / "icvl" / "01" / "cup1_0.txt"] = texts[root / "icvl" / "01" / "cup2_0.txt"] = MATRIX
    texts[root / "ipa" / "gt" / "cycle_0000" / "002.csv"] = (
        "id,class,x,y,z," + ",".join("abcdefghi") + f",o,p\n0,bin,0,0,0,1,0,0,0,1,0,0,0,1,1,1\n{IPA_ROW}\n{IPA_ROW}\n"
    )
    texts[root / "box.obj"] = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def read(root, path):
    """Read the source that `path` belongs to, as the commands do."""
    mesh = {"mesh": root / "box.obj", "units": "m", "symmetry": "none"}
    kind = path.relative_to(root).parts[0]
    if path.suffix == ".csv" and kind == "bop":
        return adapters.function(adapters.PREDICTIONS, "bop")(path)
    options = {"bop": {}, "icvl": {"visibility": "full", **mesh}, "ipa": mesh}[kind]
    return adapters.function(adapters.GROUND_TRUTH, kind)(root / kind / ("test" if kind == "bop" else ""), **options)


def places(document, path=()):
    """Every place in a JSON document."""
    yield path
    children = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, value in children:
        yield from places(value, (*path, key))


def replaced(document, path, value):
    if not path:
        return value
    document = copy.deepcopy(document)
    parent = document
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return document


def read_or_refused(root, path, text):
    whole = path.read_text()
    path.write_text(text)
    try:
        read(root, path)
    except InputError as error:
        assert str(error)[-1] in ".?"
    finally:
        path.write_text(whole)


FUZZ = settings(max_examples=EXAMPLES, deadline=None)
JSON_FILES = ["scene_gt.json", "scene_gt_info.json", "scene_camera.json", "models_info.json", "parameter.json"]
TEXT_FILES = ["results.csv", "cup2_0.txt", "002.csv"]


@pytest.mark.parametrize("name", JSON_FILES)
@FUZZ
@given(data=st.data())
def test_odd_values_anywhere(sources, name, data):
    (path,) = sources.rglob(name)
    document = json.loads(path.read_text())
    for _ in range(data.draw(st.integers(1, 3))):
        where = data.draw(st.sampled_from(sorted(places(document), key=str)))
        document = replaced(document, where, data.draw(ODD))
    read_or_refused(sources, path, json.dumps(document))


@pytest.mark.parametrize("name", TEXT_FILES)
@FUZZ
@given(data=st.data())
def test_odd_words_anywhere(sources, name, data):
    (path,) = sources.rglob(name)
    text = path.read_text()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(start + 8, len(text))))
        word = data.draw(st.one_of(st.text("0123456789 ,.e-\nnaif/", max_size=5), st.text(max_size=3)))
        text = text[:start] + word.encode("utf-8", "replace").decode() + text[end:]
    read_or_refused(sources, path, text)


def test_every_source_is_valid_as_it_stands(sources):
    for name in JSON_FILES + TEXT_FILES:
        (path,) = sources.rglob(name)
        assert read(sources, path).images
