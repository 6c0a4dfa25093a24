"""Values of options that are more than a number: ranges, bins."""

from __future__ import annotations

import re

from evalkit.errors import InputError
from simgen.config_sections import BinSize


def parse_instances(text: str) -> tuple[int, int]:
    """``10-20`` or ``15`` to (smallest, largest) number of instances a scene.

    Raises:
        InputError: it is neither.
    """
    match = re.fullmatch(r"\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?", text)
    if match is None:
        raise InputError(f"--instances {text}: give a number or a range MIN-MAX, as in 10-20.")
    return int(match[1]), int(match[2] or match[1])


def parse_range(option: str, text: str) -> tuple[float, float]:
    """``10-50`` or ``30`` to (smallest, largest).

    Raises:
        InputError: it is neither.
    """
    number = r"(\d{1,9}(?:\.\d{1,9})?)"
    match = re.fullmatch(rf"\s*{number}\s*(?:-\s*{number}\s*)?", text)
    if match is None or float(match[2] or match[1]) < float(match[1]):
        raise InputError(f"{option} {text}: give a number or a range MIN-MAX, as in 0.5-1.5.")
    return float(match[1]), float(match[2] or match[1])


def parse_shards(text: str, count: int) -> range:
    """``0-9`` or ``7`` to the shards of that many that are meant; what is beyond the last is left out.

    Raises:
        InputError: it is neither, or there are none.
    """
    match = re.fullmatch(r"\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?", text)
    shards = range(0) if match is None else range(int(match[1]), min(int(match[2] or match[1]) + 1, count))
    if not shards:
        raise InputError(
            f"--shards {text}: give a number or a range FIRST-LAST of the {count} shards, 0 to {count - 1}."
        )
    return shards


def parse_bin(text: str) -> BinSize | None:
    """``auto`` (None) or ``WxDxH`` in meters.

    Raises:
        InputError: it is neither.
    """
    if text == "auto":
        return None
    try:
        width, depth, height = (float(side) for side in text.lower().split("x"))
    except ValueError:
        raise InputError(f"--bin {text}: give auto or the inner WxDxH in meters, as in 0.4x0.3x0.1.") from None
    return BinSize(width, depth, height)
