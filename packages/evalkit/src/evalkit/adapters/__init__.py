"""Other people's formats in, ours out, and back where that makes sense: one module a format.

What can be done with a format stands in the tables below. The keyword parameters of the function named there are the
options that the format takes; any other is refused by name. So a new format needs a module and a line here, and a
module is imported only when its format is asked for.
"""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

from evalkit.errors import InputError

GROUND_TRUTH = {
    "shards": "evalkit.datasets.ground_truth:read_ground_truth",
    "sileane": "evalkit.adapters.sileane.dataset:read_ground_truth",
    "bop": "evalkit.adapters.bop.dataset:read_ground_truth",
    "icvl": "evalkit.adapters.icvl:read_ground_truth",
    "ipa": "evalkit.adapters.ipa:read_ground_truth",
}
PREDICTIONS = {
    "binpose": "evalkit.datasets.documents:read_predictions",
    "shards": "evalkit.datasets.ground_truth:read_predictions",
    "sileane": "evalkit.adapters.sileane.dataset:read_predictions",
    "bop": "evalkit.adapters.bop.results:read_predictions",
    "icvl": "evalkit.adapters.icvl:read_predictions",
    "ipa": "evalkit.adapters.ipa:read_predictions",
}
WRITERS = {
    "binpose": "evalkit.datasets.documents:write_predictions",
    "bop": "evalkit.adapters.bop.results:write_predictions",
    "sileane": "evalkit.adapters.sileane.dataset:write_predictions",
}
DEPTH_IMAGES = {
    "sileane": "evalkit.adapters.sileane.dataset:depth_images",
    "bop": "evalkit.adapters.bop.dataset:depth_images",
    "icvl": "evalkit.adapters.icvl:depth_images",
    "ipa": "evalkit.adapters.ipa:depth_images",
}
OPTION_NAMES = {"object_name": "--object"}


def function(table: dict[str, str], kind: str) -> Any:
    """The function that a table names for a format."""
    module, _, name = table[kind].partition(":")
    return getattr(import_module(module), name)


def options_of(table: dict[str, str], kind: str) -> set[str]:
    """The options that a format takes."""
    parameters = inspect.signature(function(table, kind)).parameters
    return {name for name, parameter in parameters.items() if parameter.default is not parameter.empty}


def refuse_unknown(options: dict[str, Any], known: set[str], asked: str) -> None:
    """Options that are given (not None) must be `known`; `asked` names what the user chose, such as ``--from bop``.

    Raises:
        InputError: one is not.
    """
    for name, value in options.items():
        if value is not None and name not in known:
            takes = ", ".join(sorted(map(option_name, known))) or "none of these options"
            raise InputError(f"{option_name(name)} means nothing with {asked}, which takes {takes}.")


def option_name(parameter: str) -> str:
    """A parameter as the user types it."""
    return OPTION_NAMES.get(parameter, "--" + parameter.replace("_", "-"))


def given(options: dict[str, Any], known: set[str]) -> dict[str, Any]:
    """The options that are both given and known."""
    return {name: value for name, value in options.items() if value is not None and name in known}
