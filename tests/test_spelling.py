"""One spelling, the American one of the libraries beneath, wherever words stand."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BRITISH = re.compile(
    r"metre|centre|centring|colour|grey|neighbour|behaviour|favour|labelled|labelling|modelled|modelling|learnt|spoilt"
    r"|towards|artefact|licence|tunnelled"
    r"|(canonical|general|initial|maxim|minim|normal|orthogonal|quant|raster|recogn|regular|serial|summar|visual)is(e|ing|ation)"
    r"|optimis(e|ing|ation)",
    re.IGNORECASE,
)
IN_FILES_ALREADY = (
    "registration_neighbours",
    '"metre"',
    '"metres"',
    ".METRE.",
    '"colour"',
)  # fields of model files, of what evalkit ap --json writes, of STEP and of camera files
TEXT = (".py", ".md", ".html", ".js", ".css", ".toml", ".yml", ".cff", "Makefile", "Dockerfile")
FOLDERS = ("packages", "benchmarks", "tests", "docs", "data")
AT_THE_ROOT = ("*.md", "*.toml", "*.yml", "*.cff", "Makefile", "Dockerfile")


def test_words_are_spelled_as_in_america() -> None:
    command = ["git", "ls-files", "-z", *FOLDERS, *AT_THE_ROOT]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a checkout of git")
    found = []
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if not name.endswith(TEXT) or path == Path(__file__) or not path.is_file():
            continue
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            for field in IN_FILES_ALREADY:
                line = line.replace(field, "")
            found += [f"{name}:{number}: {match[0]}" for match in BRITISH.finditer(line)]
    assert not found
