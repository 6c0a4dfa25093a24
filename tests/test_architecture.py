"""The rules that keep the three packages apart."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("evalkit", "simgen", "posenet")
ALLOWED = {"evalkit": set(), "simgen": {"evalkit"}, "posenet": {"evalkit"}}
LONGEST, LONGEST_TEST, FULLEST = 300, 400, 20  # lines of a source file, of a test file; source files of a folder
ONE_MEANING = {
    "__init__": "what lives in the folder",
    "cli": "the package's command",
    "config": "the package's settings",
    "dataset": "frames, as a format or a training has them",
    "export": "what we have, written in somebody else's format",
}
FLOORS = {  # from the ground up; a room imports rooms of lower floors only
    "evalkit": [
        ["errors"],
        ["atomic", "json_file", "image_file", "typed"],
        ["geometry"],
        ["objects"],
        ["meshes"],
        ["datasets"],
        ["adapters", "scoring"],
        ["depth", "drawing"],
        ["evidence"],
        ["reports"],
        ["commands"],
    ],
    "simgen": [
        ["compiled", "config_sections"],
        ["sensors"],
        ["config", "physics", "rendering"],
        ["presets", "config_json"],
        ["objects"],
        ["scenes", "exports", "previews"],
        ["workers", "sensor_fit"],
        ["building"],
        ["commands"],
    ],
}
THEIRS = {"gl_renderer.py": {"_renderer"}}  # of pyrender's offscreen renderer
NAMED_TUPLES = ("_asdict", "_fields", "_make", "_replace")  # public, whatever their names say


def sources(package: str) -> list[Path]:
    found = sorted((ROOT / "packages" / package / "src" / package).rglob("*.py"))
    assert found
    return found


def tracked(*patterns: str) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a checkout of git")
    return [path for name in listed.stdout.split("\0") if name and (path := ROOT / name).is_file()]


def imported_packages(source: Path) -> Iterator[str]:
    """Top-level names imported anywhere in a file, inside functions too."""
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_what_the_design_allows(package: str) -> None:
    others = set(PACKAGES) - {package} - ALLOWED[package]
    for source in sources(package):
        wrong = others & set(imported_packages(source))
        assert not wrong, f"{source.relative_to(ROOT)} imports {wrong}"


def test_the_leaf_needs_no_physics_gl_or_torch() -> None:
    heavy = {"torch", "pybullet", "pyrender", "OpenGL", "lightning_fabric", "numba"}
    for source in sources("evalkit"):
        wrong = heavy & set(imported_packages(source))
        assert not wrong, f"{source.relative_to(ROOT)} imports {wrong}"


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_is_unpickled(package: str) -> None:
    for source in sources(package):
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = ast.unparse(node.func)
            options = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            where = f"{source.relative_to(ROOT)}:{node.lineno}"
            assert name not in ("pickle.load", "pickle.loads", "joblib.load"), where
            if name == "torch.load":
                assert options.get("weights_only") == "True", where
            if name in ("np.load", "numpy.load"):
                assert options.get("allow_pickle", "False") == "False", where


def private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name not in NAMED_TUPLES


def private_names(source: Path) -> tuple[set[str], set[str]]:
    """The underscore names that a file defines, and those that it uses of something else."""
    defined, used = set(), set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            defined.add(node.id)
        elif isinstance(node, ast.Attribute):
            (defined if isinstance(node.ctx, ast.Store) else used).add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            used |= {alias.name for alias in node.names}
    return {name for name in defined if private(name)}, {name for name in used if private(name)}


def test_no_module_reaches_into_another() -> None:
    """An underscore name stays in its file; those of libraries that have nothing public are not ours to rename."""
    files = [source for package in PACKAGES for source in sources(package)] + sorted(
        (ROOT / "benchmarks").rglob("*.py")
    )
    names = {source: private_names(source) for source in files}
    ours = set().union(*(defined for defined, _ in names.values()))
    for source, (defined, used) in names.items():
        foreign = sorted((used & ours) - defined - THEIRS.get(source.name, set()))
        assert not foreign, f"{source.relative_to(ROOT)} uses {', '.join(foreign)} of another module"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_is_a_drawer_for_everything(package: str) -> None:
    names = {source.stem for source in sources(package)}
    assert not names & {"utils", "util", "helpers", "misc", "common"}


@pytest.mark.parametrize("package", PACKAGES)
def test_the_readme_lists_every_folder_of_a_package_and_no_other(package: str) -> None:
    root = ROOT / "packages" / package / "src" / package
    tree = (ROOT / "README.md").read_text(encoding="utf-8").split(f"packages/{package}/src/{package}/")[1]
    listed = re.findall(r"^    ([\w/]+)/ ", tree.split("\npackages/")[0], re.MULTILINE)
    folders = {source.parent.relative_to(root).as_posix() for source in sources(package)} - {"."}
    assert sorted(listed) == sorted(folders)


def test_a_newcomers_questions_are_answered_by_folders_that_there_are() -> None:
    answers = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Where is")[1]
    folders = re.findall(r"`((?:evalkit|simgen|posenet)/[a-z/]+)`", answers)
    assert len(folders) >= 10
    for folder in folders:
        package = folder.split("/")[0]
        assert (ROOT / "packages" / package / "src" / folder / "__init__.py").is_file(), folder


@pytest.mark.parametrize("package", PACKAGES)
def test_every_folder_says_what_lives_there(package: str) -> None:
    for folder in {source.parent for source in sources(package)}:
        text = (folder / "__init__.py").read_text(encoding="utf-8")
        assert ast.get_docstring(ast.parse(text)), f"{folder.relative_to(ROOT)}/__init__.py has no docstring"


def test_no_source_file_is_longer_than_a_reader_holds_in_mind() -> None:
    lengths = {path.relative_to(ROOT): path.read_text("utf-8").count("\n") for path in tracked("*.py", "*.js", "*.css")}
    too_long = {
        str(path): lines
        for path, lines in lengths.items()
        if lines > (LONGEST_TEST if path.parts[0] == "tests" else LONGEST)
    }
    assert not too_long


def test_no_folder_is_fuller_than_a_reader_overlooks() -> None:
    folders = Counter(path.parent for path in tracked("packages/**/*.py", "packages/**/*.js", "packages/**/*.html"))
    too_full = {str(folder.relative_to(ROOT)): count for folder, count in folders.items() if count > FULLEST}
    assert not too_full


def test_a_file_name_means_one_thing() -> None:
    names = Counter(source.stem for package in PACKAGES for source in sources(package))
    twice = {name for name, count in names.items() if count > 1}
    assert twice <= set(ONE_MEANING)


def rooms_imported(package: str) -> dict[str, set[str]]:
    """Of each room, a folder or a file in the package's root, the rooms that its files import, inside functions too."""
    root = ROOT / "packages" / package / "src" / package
    rooms: dict[str, set[str]] = {}
    for source in sources(package):
        room = source.relative_to(root).parts[0].removesuffix(".py")
        modules = set[str]()
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module == package:
                modules.update(f"{package}.{alias.name}" for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                modules.add(node.module)
        inside = {module.split(".")[1] for module in modules if module.startswith(f"{package}.")}
        rooms.setdefault(room, set()).update(inside - {room})
    return rooms


@pytest.mark.parametrize("package", PACKAGES)
def test_rooms_import_each_other_in_no_circle(package: str) -> None:
    try:
        list(TopologicalSorter(rooms_imported(package)).static_order())
    except CycleError as error:
        pytest.fail(f"{package}: {' <- '.join(error.args[1])}")


def test_rooms_import_downwards() -> None:
    for package, floors in FLOORS.items():
        imported = rooms_imported(package)
        order = {room: floor for floor, rooms in enumerate(floors) for room in rooms}
        wrong = {
            (room, other)
            for room, others in imported.items()
            for other in others
            if room in order and other in order and order[other] >= order[room]
        }
        assert not wrong, f"{package}: {wrong}"


def test_a_preview_of_shards_needs_no_scoring() -> None:
    code = (
        "import sys, simgen.commands.cli, evalkit.drawing.page, evalkit.drawing.plots; "
        "import simgen.previews.preview_page, simgen.previews.sheet; "
        "print([name for name in sys.modules if name.startswith(('evalkit.scoring', 'evalkit.reports'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", PACKAGES)
def test_every_command_explains_itself(command: str) -> None:
    executable = Path(sys.executable).with_name(command)
    done = subprocess.run([str(executable), "--help"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert "Usage:" in done.stdout
