"""A machine without OpenGL is told from one that is too slow to say. Needs neither pyrender nor OpenGL."""

from __future__ import annotations

import importlib.util
import os

import pytest

from evalkit.errors import InputError
from simgen.rendering import gl_platform
from simgen.rendering.gl_platform import SETTLED, VARIABLE, require_gl

SLEEPS, FAILS = "import time; time.sleep(60)", "raise SystemExit(1)"
EGL_SLEEPS_OSMESA_WORKS = f"import os, sys, time; os.environ['{VARIABLE}'] == 'egl' and time.sleep(60)"
EGL_SLEEPS_OSMESA_FAILS = EGL_SLEEPS_OSMESA_WORKS + "; sys.exit(1)"


@pytest.fixture
def probing(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Pyrender seems installed, no platform is settled on, and a probe may take a second."""
    for name in (VARIABLE, SETTLED):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(gl_platform, "PROBE_SECONDS", 1)
    return monkeypatch


@pytest.mark.parametrize(
    ("probe", "says", "says_not"),
    [
        (SLEEPS, r"by egl and by osmesa gave no answer within 1 s: .*slow or busy.*run again", "apt-get"),
        (FAILS, r"no OpenGL .*egl or osmesa.*apt-get install libegl1", "slow"),
        (EGL_SLEEPS_OSMESA_FAILS, r"by egl gave no answer within 1 s \(osmesa does not work here\)", "apt-get"),
    ],
    ids=["slow", "missing", "one slow, one missing"],
)
def test_a_slow_machine_is_not_called_one_without_driver(
    probing: pytest.MonkeyPatch, probe: str, says: str, says_not: str
) -> None:
    probing.setattr(gl_platform, "PROBE", probe)
    with pytest.raises(InputError, match=says) as refused:
        require_gl()
    assert says_not not in str(refused.value)
    assert VARIABLE not in os.environ


def test_a_platform_that_is_too_slow_does_not_keep_the_next_from_being_tried(probing: pytest.MonkeyPatch) -> None:
    probing.setattr(gl_platform, "PROBE", EGL_SLEEPS_OSMESA_WORKS)
    require_gl()
    assert os.environ[VARIABLE] == "osmesa"
