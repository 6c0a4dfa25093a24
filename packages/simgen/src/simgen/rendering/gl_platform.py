"""Which OpenGL draws without a display on this machine: EGL (a GPU's driver, or Mesa on the CPU) or OSMesa."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from enum import Enum

from evalkit.errors import InputError

VARIABLE = "PYOPENGL_PLATFORM"  # read by PyOpenGL at its first import, and by pyrender; workers inherit it
PLATFORMS = ("egl", "osmesa")
SETTLED = "BINPOSE_GL"  # the platform that was found to work; workers inherit it too, and need not try again
PROBE = "import pyrender; pyrender.OffscreenRenderer(8, 8).delete()"
PROBE_SECONDS = 60


def require_gl() -> None:
    """Settle on a platform for pyrender, in this process and those that it starts, unless the user has.

    Raises:
        InputError: pyrender is not installed, no platform works, or none answered in time.
    """
    if importlib.util.find_spec("pyrender") is None:
        raise InputError(
            "--renderer pyrender: pyrender is not installed; run pip install 'binpose-simgen[pyrender]', "
            "or leave --renderer out to draw on the CPU."
        )
    if SETTLED in os.environ and os.environ[SETTLED] == os.environ.get(VARIABLE):
        return
    tried = (os.environ[VARIABLE],) if VARIABLE in os.environ else PLATFORMS
    outcome = {}
    for platform in tried:
        outcome[platform] = _try(platform)
        if outcome[platform] is Outcome.WORKS:
            os.environ[VARIABLE] = os.environ[SETTLED] = platform
            return
    raise InputError(_refusal(outcome))


class Outcome(Enum):
    """What came of trying a platform."""

    WORKS = "works"
    FAILS = "fails"
    TOO_SLOW = "took longer than we wait"


def _refusal(outcome: dict[str, Outcome]) -> str:
    """Why there is no OpenGL: no driver, or a machine that had no answer in time, which says nothing of its drivers."""
    slow = [platform for platform, one in outcome.items() if one is Outcome.TOO_SLOW]
    failed = [platform for platform, one in outcome.items() if one is Outcome.FAILS]
    if slow:
        others = f" ({' and '.join(failed)} does not work here)" if failed else ""
        return (
            f"--renderer pyrender: OpenGL by {' and by '.join(slow)} gave no answer within {PROBE_SECONDS} s{others}: "
            "this machine is slow or busy, and its driver may well work; run again when less else runs, or leave "
            "--renderer out to draw on the CPU."
        )
    return (
        f"--renderer pyrender: no OpenGL without a display works here ({VARIABLE} {' or '.join(failed)}); install one, "
        "on Debian and Ubuntu with apt-get install libegl1 libgl1, or leave --renderer out to draw on the CPU."
    )


def _try(platform: str) -> Outcome:
    """Tried in a process of its own, for PyOpenGL cannot change its platform, and a driver may take us along."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE], env={**os.environ, VARIABLE: platform}, timeout=PROBE_SECONDS,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Outcome.TOO_SLOW
    return Outcome.WORKS if done.returncode == 0 else Outcome.FAILS
