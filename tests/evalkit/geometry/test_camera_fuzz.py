"""Camera files with odd fields: read, or refused in one sentence that names the file; never a traceback."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evalkit.errors import InputError
from evalkit.geometry.camera_files import read_camera

BASE = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0}
K = [600.0, 0, 320.0, 0, 600.0, 240.0, 0, 0, 1]
NO_VALUES = (
    None,
    True,
    -1,
    0,
    0.5,
    "a",
    "",
    [],
    {},
    [1],
    [[1, 2], [3]],
    10**400,
    float("nan"),
    float("inf"),
    [K],
    BASE,
)
GROUPS = ({"data": K}, {"data": "x"}, [None] * 9, {"x_offset": 5, "width": -3}, {"x_offset": 1e9}, [640, 480], K)
ODD = st.sampled_from([*NO_VALUES, *GROUPS])
KEYS = st.sampled_from(
    [
        "width",
        "height",
        "fx",
        "K",
        "P",
        "D",
        "distortion",
        "distortion_model",
        "model",
        "roi",
        "binning_x",
        "skew",
        "resolution",
        "f",
        "principal_point",
        "intrinsics",
        "intrinsic_matrix",
        "camera_matrix",
        "R",
        "depth_scale",
        "cam_K",
        "fisheye_model",
        "camera_model",
        "colmap",
        "k1",
        "depth",
        "0",
        "image_size",
    ]
)


@settings(max_examples=300, deadline=None)
@given(changes=st.dictionaries(KEYS, ODD, max_size=3), named=st.booleans(), rectified=st.booleans())
def test_whatever_a_camera_file_holds_it_is_read_or_refused_in_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, changes: dict[str, object], named: bool, rectified: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzzed.json"
    document = (BASE if named else {"width": 640, "height": 480, "K": K}) | changes
    path.write_text(json.dumps(document))
    try:
        read_camera(path, rectified)
    except InputError as error:
        assert "fuzzed.json" in str(error) and "\n" not in str(error)
