"""What a release states: one version everywhere, and metadata that says whose it is and what it needs."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
import yaml

ROOT = Path(__file__).parents[1]


def version_tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("version_tool", ROOT / "tools" / "version.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TOOL = version_tool()


@pytest.mark.parametrize("path", TOOL.PATTERNS)
def test_every_file_states_the_version_of_the_one_file(path: str) -> None:
    assert (ROOT / path).read_text(encoding="utf-8") == TOOL.with_version(path, TOOL.stated_version())


@pytest.mark.parametrize("package", ["simgen", "posenet"])
def test_a_new_version_moves_the_pin_on_evalkit_along(package: str) -> None:
    text = TOOL.with_version(f"packages/{package}/pyproject.toml", "7.8.9")
    assert 'version = "7.8.9"' in text and '"binpose-evalkit==7.8.9"' in text
    assert f'"{TOOL.stated_version()}"' not in text


def test_the_changelog_tells_of_this_version() -> None:
    assert f"\n## {TOOL.stated_version()} " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_citation_names_the_paper_and_this() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0" and citation["version"] == TOOL.stated_version()
    assert [author["family-names"] for author in citation["references"][0]["authors"]] == [
        "Sock",
        "Kim",
        "Sahin",
        "Kim",
    ]
