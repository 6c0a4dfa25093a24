"""The unit of a mesh file: what the user says, else what the file states, else what its size makes plausible."""

from __future__ import annotations

from evalkit.errors import InputError

METERS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254, "micron": 1e-6, "foot": 0.3048}
WORDS = {"m": "meters", "cm": "centimeters", "mm": "millimeters", "inch": "inches", "micron": "micrometers",
         "foot": "feet"}  # fmt: skip
CHOICES = ("auto", "m", "cm", "mm", "inch")  # of --units; a file may state the others
GUESSED = ("m", "mm")  # what CAD programs write unless they are asked for another
USUAL = (0.005, 1.0)  # meters: the largest side of what is picked from bins
LIKELY = (0.005, 0.4)  # meters: a reading that gives such a size deserves a word where another one was taken
POSSIBLE = (0.002, 2.0)
USABLE = (5e-4, 10.0)  # beyond, neither the physics nor a depth image of 16 bits makes sense
GLTF = ("glb", "gltf")
STEP = ("step", "stp")


def decide_units(
    units: str, largest_side: float, extension: str, where: str, stated: str | None = None
) -> tuple[str, str, list[str]]:
    """The file's unit (a key of METERS), the reason in words, and warnings.

    Args:
        units: what the user said, one of CHOICES.
        largest_side: of the mesh's bounding box, in the file's unit.
        extension: the file's, without the dot.
        where: how to name the file in a sentence.
        stated: the unit that the file itself states; glTF is in meters by its specification.

    Raises:
        InputError: `units` is unknown or contradicts a STEP file, or is `auto` where no unit gives a plausible size.
    """
    stated = "m" if extension in GLTF else stated
    if units not in CHOICES:
        raise InputError(f"--units {units}: use {', '.join(CHOICES)} (and --scale for any other unit).")
    if units != "auto" and extension in STEP:
        raise InputError(f"{where}: STEP files state their unit, and were read in it; leave --units {units} out.")
    if units != "auto":
        return units, "as given by --units", _contradiction(units, stated)
    if stated is not None:
        return stated, _statement(extension), []
    for low, high in (USUAL, POSSIBLE):
        for unit in GUESSED:
            if low <= largest_side * METERS[unit] <= high:
                return unit, f"its largest side is {largest_side:.4g}", _doubts(unit, largest_side)
    raise InputError(
        f"{where}: its largest side of {largest_side:.4g} is a plausible size neither in meters nor in millimeters; "
        "say --units m, cm, mm or inch, and --scale for any other unit."
    )


def check_size(largest_side: float, where: str) -> list[str]:
    """Warnings about an object's largest side in meters.

    Raises:
        InputError: it is beyond what can be simulated and stored; millimeters read as meters mostly are.
    """
    if not USABLE[0] <= largest_side <= USABLE[1]:
        raise InputError(
            f"{where}: {largest_side:.4g} m across is out of range ({USABLE[0]:g} to {USABLE[1]:g} m); "
            "check --units and --scale."
        )
    if not POSSIBLE[0] <= largest_side <= POSSIBLE[1]:
        return [f"The object is {largest_side:.4g} m across, unusual for bin picking; check --units and --scale."]
    return []


def _statement(extension: str) -> str:
    return "glTF is in meters by its specification" if extension in GLTF else "as the file states"


def _contradiction(units: str, stated: str | None) -> list[str]:
    if stated is None or stated == units:
        return []
    return [f"The file states {WORDS[stated]}; --units {units} stands above that."]


def _doubts(taken: str, largest_side: float) -> list[str]:
    """A warning where the size taken is unusual, or another unit gives a likely one."""
    others = [unit for unit in CHOICES[1:] if unit != taken and _within(LIKELY, largest_side * METERS[unit])]
    if not others and _within(USUAL, largest_side * METERS[taken]):
        return []
    readings = ", ".join(f"{largest_side * 1e3 * METERS[unit]:.4g} mm in {WORDS[unit]}" for unit in others)
    choices = " or ".join(f"--units {unit}" for unit in others or [unit for unit in GUESSED if unit != taken])
    return [
        f"The unit is not certain: the largest side of {largest_side:.4g} was read as {WORDS[taken]}"
        f"{f'; it would be {readings}' if readings else ''}; if that is wrong, say {choices}."
    ]


def _within(limits: tuple[float, float], size: float) -> bool:
    return limits[0] <= size <= limits[1]
