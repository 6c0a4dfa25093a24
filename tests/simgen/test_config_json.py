"""A config comes back from its JSON as it went in, and nothing else comes out of JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from evalkit.errors import InputError
from simgen.config_json import config_from_json
from simgen.config_sections import BinSize
from simgen.presets import PRESETS, debug
from simgen.sensors.sensor_config import SENSORS


@pytest.mark.parametrize("preset", PRESETS)
def test_every_config_comes_back(preset: str) -> None:
    config = PRESETS[preset]()
    for variant in (
        config,
        replace(config, bin=BinSize(0.3, 0.2, 0.1, walls=False)),
        replace(config, sensor=SENSORS["stereo"](), keep_ideal=True),
    ):
        document = json.loads(json.dumps(variant.to_json() | {"geometry_sha256": "of the header, not of the config"}))
        assert config_from_json(document, "here") == variant


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda d: d.pop("views"), "the field 'views' is missing"),
        (lambda d: d["pile"].pop("layers"), "here.pile: the field 'layers'"),
        (lambda d: d["pile"].update(holes=3), "here.pile: the field 'holes'"),
        (lambda d: d.update(views="3"), "here.views: expected int, got str"),
        (lambda d: d.update(views=True), "here.views: expected int, got bool"),
        (lambda d: d.update(keep_ideal=1), "here.keep_ideal: expected bool, got int"),
        (lambda d: d.update(views=0), "here: --views 0"),
        (lambda d: d.update(physics=None), "here.physics: expected object, got null"),
        (lambda d: d.update(physics=3), "here.physics: expected an object with the fields engine, rules"),
        (lambda d: d["camera"].pop("fx"), "here.camera: the field 'fx'"),
    ],
)
def test_what_is_no_config_is_named(spoil: Callable[[dict[str, Any]], object], sentence: str) -> None:
    document = json.loads(json.dumps(debug().to_json()))
    spoil(document)
    with pytest.raises(InputError, match=sentence):
        config_from_json(document, "here")
    with pytest.raises(InputError, match="here: expected the config"):
        config_from_json([], "here")
