"""The packages as strangers get them: wheels, in an environment that has never seen the repository."""

from __future__ import annotations

import email
import json
import shutil
import subprocess
import sys
import venv
import zipfile
from email.message import Message
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("evalkit", "simgen", "posenet")
MODEL = ROOT / "data" / "models" / "bunny-stereo.pt"


def succeed(*words: object, cwd: Path | None = None) -> str:
    done = subprocess.run(list(map(str, words)), cwd=cwd, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each package's wheel, built from a copy of its sources, for setuptools leaves a build folder beside them."""
    folder = tmp_path_factory.mktemp("wheels")
    leftovers = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT / "packages", folder / "packages", ignore=leftovers)
    sources = [folder / "packages" / package for package in PACKAGES]
    succeed(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder / "dist", *sources)
    return {package: next((folder / "dist").glob(f"binpose_{package}-*.whl")) for package in PACKAGES}


@pytest.fixture(scope="module")
def bare(wheels: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the three wheels; other packages are those of the running one, ours are not."""
    folder = tmp_path_factory.mktemp("bare") / "venv"
    venv.create(folder)
    python = folder / "bin" / "python"
    succeed(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", *wheels.values())
    (site,) = folder.glob("lib/python*/site-packages")
    # Folders named in a .pth file are searched last, and .pth files inside them, editable packages', are not read.
    others = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    (site / "others.pth").write_text("\n".join(others))
    return folder


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_bytes(archive.read(name))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_file_of_a_package_is_in_its_wheel(package: str, wheels: dict[str, Path]) -> None:
    source = ROOT / "packages" / package / "src"
    files = (path.relative_to(source).as_posix() for path in (source / package).rglob("*") if path.is_file())
    with zipfile.ZipFile(wheels[package]) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert packed == {file for file in files if "__pycache__" not in file}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_wheel_says_whose_it_is_and_what_it_needs(package: str, wheels: dict[str, Path]) -> None:
    about, version = metadata(wheels[package]), (ROOT / "VERSION").read_text().strip()
    assert about["Version"] == version and about["License-Expression"] == "MIT" and about["License-File"] == "LICENSE"
    assert about["Summary"] and about["Keywords"] and about["Author"] == "the binpose contributors"
    assert f"pip install binpose-{package}" in str(about.get_payload()), "the readme"
    assert {"Homepage", "Documentation", "Issues", "Changelog"} <= {
        url.split(",")[0] for url in about.get_all("Project-URL", [])
    }
    needed = [need for need in about.get_all("Requires-Dist", []) if need.startswith("binpose-")]
    assert needed == ([] if package == "evalkit" else [f"binpose-evalkit=={version}"])
    assert not any("torch" in need and "<" in need for need in about.get_all("Requires-Dist", []))


def test_the_three_commands_work_where_only_wheels_are_installed(bare: Path, tmp_path: Path) -> None:
    commands = bare / "bin"
    script = "import evalkit, posenet, simgen; print(evalkit.__file__, posenet.__file__, simgen.__file__, sep='\\n')"
    for path in succeed(commands / "python", "-c", script, cwd=tmp_path).split():
        assert Path(path).is_relative_to(bare)
    succeed(commands / "simgen", "build", "--object", "bunny", "--preset", "debug", "--scenes", 2, "-o", "shards",
            cwd=tmp_path)  # fmt: skip
    succeed(commands / "posenet", "predict", MODEL, "shards", "-o", "preds.json", cwd=tmp_path)
    succeed(commands / "evalkit", "gt", "shards", "-o", "gt.json", cwd=tmp_path)
    said = succeed(commands / "evalkit", "ap", "preds.json", "gt.json", "--json", "ap.json", cwd=tmp_path)
    succeed(commands / "simgen", "preview", "shards", "-o", "preview.html", cwd=tmp_path)
    succeed(commands / "evalkit", "report", "preds.json", "gt.json", "-o", "report.html", cwd=tmp_path)
    assert "AP" in said and 0 <= json.loads((tmp_path / "ap.json").read_text())["ap"] <= 1
