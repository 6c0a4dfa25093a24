"""A network trained for some steps: enough for it to detect something."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def run_folder(debug_shards: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from posenet.config import preset
    from posenet.training.fit_options import FitOptions
    from posenet.training.train import fit

    out = tmp_path_factory.mktemp("run")
    return fit(FitOptions([debug_shards], out, preset("debug"), epochs=40, device="cpu", validate=False)).path
