"""Metres or millimetres? Decided by size, never silently."""

from __future__ import annotations

from evalkit.errors import InputError

METRES = {"m": 1.0, "mm": 1e-3}
WORDS = {"m": "metres", "mm": "millimetres"}
USUAL = (0.005, 1.0)  # metres: the largest side of what is picked from bins
POSSIBLE = (0.002, 2.0)
USABLE = (1e-4, 100.0)  # beyond, the physics and the depth image's 16 bits make no sense


def decide_units(units: str, largest_side: float, extension: str, where: str) -> tuple[str, str, list[str]]:
    """The file's unit ("m" or "mm"), the reason in words, and warnings.

    Args:
        units: what the user said: auto, m or mm.
        largest_side: of the mesh's bounding box, in the file's unit.
        extension: the file's, without the dot; glTF is in metres by its specification.
        where: how to name the file in a sentence.

    Raises:
        InputError: `units` is unknown, or `auto` where neither unit gives a plausible size.
    """
    if units in METRES:
        return units, "as given by --units", []
    if units != "auto":
        raise InputError(f"--units {units}: use auto, m or mm (and --scale for any other unit).")
    if extension in ("glb", "gltf"):
        return "m", "glTF is in metres by its specification", []
    for limits, warn in ((USUAL, False), (POSSIBLE, True)):
        for unit, metres in METRES.items():
            if limits[0] <= largest_side * metres <= limits[1]:
                return unit, f"its largest side is {largest_side:.4g}", [_doubt(unit, largest_side)] if warn else []
    raise InputError(
        f"{where}: its largest side of {largest_side:.4g} is a plausible size neither in metres nor in millimetres; "
        "say --units m or --units mm, and --scale for any other unit."
    )


def check_size(largest_side: float, where: str) -> list[str]:
    """Warnings about an object's largest side in metres.

    Raises:
        InputError: it is beyond what can be simulated and stored.
    """
    if not USABLE[0] <= largest_side <= USABLE[1]:
        raise InputError(
            f"{where}: {largest_side:.4g} m across is out of range ({USABLE[0]:g} to {USABLE[1]:g} m); "
            "check --units and --scale."
        )
    if not POSSIBLE[0] <= largest_side <= POSSIBLE[1]:
        return [f"The object is {largest_side:.4g} m across, unusual for bin picking; check --units and --scale."]
    return []


def _doubt(unit: str, largest_side: float) -> str:
    other = "mm" if unit == "m" else "m"
    return (
        f"The unit is not certain: the largest side of {largest_side:.4g} was read as {WORDS[unit]}; "
        f"if it is {WORDS[other]}, say --units {other}."
    )
