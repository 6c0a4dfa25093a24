"""A configuration comes back from its document, and documents older than a choice mean what they meant."""

from __future__ import annotations

import json

import pytest

from evalkit.errors import InputError
from posenet.config import PRESETS, Config, preset


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_comes_back_from_json(name: str) -> None:
    assert Config.from_json(json.loads(json.dumps(preset(name).to_json()))) == preset(name)


def test_a_document_from_before_the_crops_could_be_chosen_means_the_crops_of_then() -> None:
    document = preset("small").to_json()
    for name in ("crop_widths", "crop_layers"):
        del document["network"][name]
    network = Config.from_json(document).network
    assert (network.crop_widths, network.crop_layers) == ((32, 64, 64), 1)


def test_a_document_of_another_version_is_refused_in_one_sentence() -> None:
    document = preset("small").to_json()
    document["network"]["telepathy"] = True
    with pytest.raises(InputError, match="not a configuration of this posenet version"):
        Config.from_json(document, "model.pt")
