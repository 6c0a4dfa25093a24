"""The documentation agrees with the code, and its pages with each other."""

from __future__ import annotations

import importlib.util
import re
import sys
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import pytest

from evalkit.meshes import read, units
from evalkit.objects import symmetry
from evalkit.scoring.distances import CRITERIA
from evalkit.scoring.rules import PROTOCOLS
from simgen.sensors.sensor_config import SENSORS, SensorConfig

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("evalkit", "simgen", "posenet")
BUILT = {"errors.md", "commands.md", *(f"api/{package}.md" for package in PACKAGES)}  # `make docs` writes them
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)\s]*)?\)")


def script(name: str) -> ModuleType:
    """A module of docs/scripts, which is no package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "scripts" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def pages() -> list[Path]:
    """README and the pages, but those that `make docs` wrote."""
    found = sorted((ROOT / "docs").rglob("*.md"))
    return [ROOT / "README.md", *(page for page in found if page.relative_to(ROOT / "docs").as_posix() not in BUILT)]


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_into_the_repository_leads_somewhere(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" not in target and target not in BUILT:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_every_page_stands_in_the_sites_menu() -> None:
    menu = (ROOT / "zensical.toml").read_text(encoding="utf-8")
    names = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")} | BUILT
    assert names == set(re.findall(r'"([\w/-]+\.md)"', menu))


def test_the_catalogue_of_errors_holds_every_sentence_of_the_sources() -> None:
    page = re.sub(r"<em>.*?</em>", "*", script("error_catalogue").page())
    sources = list((ROOT / "packages").rglob("*.py"))
    missing = []
    for path in sources:
        # The first words of each sentence that is one plain text, found by other means than the script's own.
        for text in re.findall(r'raise InputError\(f?"([^"{}]{12,}?)["{]', path.read_text(encoding="utf-8")):
            wrong = text.split("; ")[0].strip().replace("*", "&#42;").replace("<", "&lt;").replace(">", "&gt;")
            missing += [] if wrong in page else [f"{path.name}: {text}"]
    assert len(sources) > 100
    assert not missing


def test_the_catalogue_of_errors_parts_the_fault_from_the_mend() -> None:
    sentence = script("error_catalogue").Sentence("evalkit", "a/b.py", 1, "<path>: too short; give more; or less.")
    assert sentence.parts == ("<path>: too short; give more", "or less.")
    assert sentence.room == "a"


def test_a_formula_becomes_mathml_that_needs_no_script() -> None:
    pytest.importorskip("latex2mathml", reason="make docs installs it")
    drawn = script("mathml").block(r"\frac{a}{b}" + "\n" + r"\sum_i p_i")
    assert drawn.count("<math") == 2 and "<mfrac>" in drawn and "script" not in drawn


@pytest.mark.parametrize("package", PACKAGES)
def test_the_reference_names_modules_that_are_there(package: str) -> None:
    source = ROOT / "packages" / package / "src"
    named = re.findall(r"^::: ([\w.]+)$", script("api_pages").page(package), re.MULTILINE)
    modules = [name for name in named if (source / (name.replace(".", "/") + ".py")).is_file()]
    assert len(modules) > 10
    assert set(named) - set(modules) <= {"posenet.load"}


def test_the_page_on_parts_names_every_mesh_format_unit_and_symmetry() -> None:
    page = (ROOT / "docs" / "own-part.md").read_text(encoding="utf-8")
    symmetries = re.findall(r"[a-z]+(?:-[a-z]+|:N)?", symmetry.SYNTAX.replace(" or ", ", "))
    for word in {*read.FORMATS, *units.CHOICES, *symmetries}:
        assert f"`{word}`" in page, word


def test_the_page_on_scoring_names_every_criterion_and_protocol() -> None:
    page = (ROOT / "docs" / "scoring.md").read_text(encoding="utf-8")
    for word in {*CRITERIA, *PROTOCOLS}:
        assert f"`{word}`" in page, word


def test_the_page_on_cameras_names_every_parameter_of_the_sensors() -> None:
    page = (ROOT / "docs" / "own-camera.md").read_text(encoding="utf-8")
    names = {field.name for field in fields(SensorConfig)} - {"model"}
    for word in names | set(SENSORS):
        assert f"`{word}`" in page, word
