"""Which OpenGL draws without a display on this machine: EGL (a GPU's driver, or Mesa on the CPU) or OSMesa."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys

from evalkit.errors import InputError

VARIABLE = "PYOPENGL_PLATFORM"  # read by PyOpenGL at its first import, and by pyrender; workers inherit it
PLATFORMS = ("egl", "osmesa")
SETTLED = "BINPOSE_GL"  # the platform that was found to work; workers inherit it too, and need not try again
PROBE = "import pyrender; pyrender.OffscreenRenderer(8, 8).delete()"
PROBE_SECONDS = 60


def require_gl() -> None:
    """Settle on a platform for pyrender, in this process and those that it starts, unless the user has.

    Raises:
        InputError: pyrender is not installed, or no platform works.
    """
    if importlib.util.find_spec("pyrender") is None:
        raise InputError(
            "--renderer pyrender: pyrender is not installed; run pip install 'binpose-simgen[pyrender]', "
            "or leave --renderer out to draw on the CPU."
        )
    if SETTLED in os.environ and os.environ[SETTLED] == os.environ.get(VARIABLE):
        return
    tried = (os.environ[VARIABLE],) if VARIABLE in os.environ else PLATFORMS
    for platform in tried:
        if _works(platform):
            os.environ[VARIABLE] = os.environ[SETTLED] = platform
            return
    raise InputError(
        f"--renderer pyrender: no OpenGL without a display works here ({VARIABLE} {' or '.join(tried)}); install one, "
        "on Debian and Ubuntu with apt-get install libegl1 libgl1, or leave --renderer out to draw on the CPU."
    )


def _works(platform: str) -> bool:
    """Tried in a process of its own, for PyOpenGL cannot change its platform, and a driver may take us along."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE], env={**os.environ, VARIABLE: platform}, timeout=PROBE_SECONDS,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0
