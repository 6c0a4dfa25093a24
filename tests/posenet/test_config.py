"""A configuration comes back from its document, and documents older than a choice mean what they meant."""

from __future__ import annotations

import json

import pytest

from evalkit.errors import InputError
from posenet.config import PRESETS, Config, preset, with_options


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_comes_back_from_json(name: str) -> None:
    assert Config.from_json(json.loads(json.dumps(preset(name).to_json()))) == preset(name)


def test_a_document_from_before_the_crops_could_be_chosen_means_the_crops_of_then() -> None:
    document = preset("small").to_json()
    for name in ("crop_widths", "crop_layers"):
        del document["network"][name]
    network = Config.from_json(document).network
    assert (network.crop_widths, network.crop_layers) == ((32, 64, 64), 1)


def test_a_document_from_before_images_trained_about_other_depths_means_that_none_did() -> None:
    document = preset("small").to_json()
    del document["train"]["reference_jitter"]
    assert Config.from_json(document).train.reference_jitter == 0.0


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"telepathy": True}, r"model.pt.network: the field 'telepathy' is unknown"),
        ({"roi_size": "8"}, r"model.pt.network.roi_size: expected int, got str"),
        ({"roi": "round"}, r"model.pt.network.roi: invalid value 'round'; use one of box, metric"),
        ({"angle_bins": [30, 13]}, r"model.pt.network.angle_bins: expected array of length 3, got 2"),
        ({"dropout": True}, r"model.pt.network.dropout: expected float, got bool"),
    ],
)
def test_what_is_no_configuration_is_refused_by_its_field(changes: dict[str, object], sentence: str) -> None:
    document = preset("small").to_json()
    document["network"] |= changes
    with pytest.raises(InputError, match=sentence):
        Config.from_json(document, "model.pt")


def test_a_choice_that_there_is_not_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match=r"option.roi: invalid value 'round'; use one of box, metric"):
        with_options(preset("small"), "network", roi="round")
