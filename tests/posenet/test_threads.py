"""Threads that wait for each other fall asleep soon, unless somebody decided otherwise."""

from __future__ import annotations

import os

import pytest

from posenet.threads import WAITING, wait_briefly


@pytest.fixture(autouse=True)
def _nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_WAIT_POLICY", *WAITING):
        monkeypatch.setenv(name, "")  # so that it is restored afterwards
        monkeypatch.delenv(name)


def test_every_kind_of_openmp_hears_of_it() -> None:
    wait_briefly()
    assert {name: os.environ[name] for name in WAITING} == WAITING


def test_what_somebody_chose_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GOMP_SPINCOUNT", "7")
    wait_briefly()
    assert os.environ["GOMP_SPINCOUNT"] == "7"
    monkeypatch.delenv("KMP_BLOCKTIME")
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    wait_briefly()
    assert "KMP_BLOCKTIME" not in os.environ
