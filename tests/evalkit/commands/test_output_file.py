"""No command loses what it was given: outputs that are inputs, or other kinds of documents, are refused before work."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from evalkit.commands.cli import main as evalkit
from evalkit.commands.command import Command
from evalkit.commands.group import Commands
from evalkit.commands.image_options import image_options
from evalkit.commands.output_file import DOCUMENTS, IMAGES, OutputFile
from posenet.commands.cli import main as posenet
from simgen.commands.cli import cli as simgen


@click.group(cls=Commands)
def tool() -> None:
    pass


@tool.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=OutputFile(*DOCUMENTS, document="binpose-preds"), default="preds.json")
@click.option("--picture", type=OutputFile(*IMAGES))
@click.option("--object", "part")
@click.option("--minutes", type=click.FloatRange(min=0, min_open=True))
@click.option("--image", multiple=True)
@image_options
def work(output: Path, **_: object) -> None:
    output.write_text("written")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an image, a mesh and documents of several kinds, entered."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    for name in ("frames/0.png", "part.stl"):
        (tmp_path / name).write_text("precious")
    (tmp_path / "gt.json").write_text(json.dumps({"format": "binpose-gt/1", "images": []}))
    (tmp_path / "old.json").write_text(json.dumps({"format": "binpose-preds/1", "images": []}))
    (tmp_path / "camera.json").write_text(json.dumps({"width": 640}))
    (tmp_path / "empty.json").touch()
    return tmp_path


REFUSED = {
    "an output that is read": (["old.json", "-o", "old.json"], "never overwritten"),
    "under another name": (["old.json", "-o", "frames/../old.json"], "never overwritten"),
    "a mesh that may be a name": (["frames", "--object", "part.stl", "-o", "part.stl"], ".json"),
    "one of the images read": (["frames", "--picture", "frames/0.png"], "never overwritten"),
    "a document of another kind": (["frames", "-o", "gt.json"], "binpose-gt"),
    "somebody else's document": (["frames", "-o", "camera.json"], "something else"),
    "a folder": (["frames", "-o", "frames"], "folder"),
    "a folder that is to be": (["frames", "-o", "results/"], "folder"),
    "a name of another kind": (["frames", "-o", "preds.h5"], ".json"),
    "below a file": (["frames", "-o", "part.stl/preds.json"], "not a folder"),
    "two outputs of one name": (["frames", "-o", "same", "--picture", "same"], "both write it"),
    "two meshes": (["frames", "--object", "a.stl", "--object", "b.stl"], "--object is given twice"),
    "no number": (["frames", "--minutes", "nan"], "--minutes nan"),
    "no end": (["frames", "--minutes", "inf"], "--minutes inf"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_would_be_lost_or_means_nothing_is_refused_before_the_work(folder: Path, what: str) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    words, sentence = REFUSED[what]
    done = CliRunner().invoke(tool, ["work", *words])
    assert done.exit_code == 2 and sentence in done.stderr and done.stderr.count("\n") == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("output", ["old.json", "empty.json", "new/preds.json", "frames/preds.json", "results"])
def test_what_the_command_wrote_before_is_written_again(folder: Path, output: str) -> None:
    (folder / "new").mkdir()
    words = ["frames", "-o", output, "--image", "1", "--image", "2", "--no-return", "nan"]
    done = CliRunner().invoke(tool, ["work", *words])
    assert (done.exit_code, done.stderr) == (0, "") and (folder / output).read_text() == "written"


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_refused_before_the_work(folder: Path) -> None:
    (folder / "closed").mkdir(mode=0o500)
    assert "no permission" in CliRunner().invoke(tool, ["work", "frames", "-o", "closed/preds.json"]).stderr


def commands(group: click.Group) -> Iterator[click.Command]:
    for command in group.commands.values():
        yield from commands(command) if isinstance(command, click.Group) else (command,)


@pytest.mark.parametrize("group", [evalkit, posenet, simgen], ids=["evalkit", "posenet", "simgen"])
def test_every_command_refuses_so(group: click.Group) -> None:
    for command in commands(group):
        assert isinstance(command, Command), command.name
        for param in command.params:
            written = (param.help or "") if isinstance(param, click.Option) else ""
            if written.startswith(("Write ", "Draw ")) and isinstance(param.type, click.Path):
                assert isinstance(param.type, OutputFile), f"{command.name} {param.opts}"


def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    from evalkit.atomic import write_text

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_text(pipe, "through")
    assert os.read(reader, 99) == b"through" and stat.S_ISFIFO(pipe.stat().st_mode)
    os.close(reader)
