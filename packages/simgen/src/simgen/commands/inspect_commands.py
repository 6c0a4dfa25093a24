"""`simgen object`, `simgen preview`, `simgen view`, `simgen verify`: look at what goes in and at what came out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evalkit.commands.command import Command
from evalkit.commands.group import EXIT_BAD_INPUT, suggest_next
from evalkit.commands.output_file import DRAWINGS, PAGES, OutputFile
from evalkit.errors import InputError
from simgen.commands.options import workers_option

if TYPE_CHECKING:
    from simgen.objects.prepare import PreparedObject

MOST_PROBLEMS = 50
MESH_SUFFIXES = (".ply", ".stl", ".obj")


@click.command("object", cls=Command)
@click.argument("source", metavar="FILE|NAME")
@click.option("--units", default="auto", show_default=True, metavar="auto|m|cm|mm|inch", help="The file's unit.")
@click.option("--scale", type=float, default=1.0, show_default=True, help="Factor on the object's size.")
@click.option(
    "--symmetry", default="auto", show_default=True, help="auto, a group's name, or name@axis: revolution@z, cyclic:4 …"
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "-o",
    "--output",
    type=OutputFile(*DRAWINGS, *MESH_SUFFIXES),
    help="Draw surface, axes and convex parts (.png), or write the mesh, in millimeters (.ply, .stl, .obj).",
)
def object_command(source: str, units: str, scale: float, symmetry: str, as_json: bool, output: Path | None) -> None:
    """Print what is understood of a mesh: units, size, soundness, symmetry, convex parts."""
    from simgen.objects.prepare import prepare_object

    prepared = prepare_object(source, units, scale, symmetry)
    document = describe_object(prepared)
    if as_json:
        click.echo(json.dumps(document, indent=1))
    else:
        click.echo(_as_text(document))
    if output is not None and output.suffix.lower() in MESH_SUFFIXES:
        _write_mesh(prepared, output)
        click.echo(f"{output}: {prepared.model.name}'s mesh, in millimeters", err=True)
        source = str(output)
    elif output is not None:
        from evalkit.drawing.plots import save
        from simgen.previews.object_picture import object_sheet

        save(object_sheet(prepared), output)
        click.echo(f"{output} written", err=True)
    if not as_json:
        suggest_next("simgen", "build", "--object", source)


def _write_mesh(prepared: PreparedObject, output: Path) -> None:
    import trimesh

    from evalkit.atomic import atomic_path

    mesh = trimesh.Trimesh(1e3 * prepared.mesh.vertices, prepared.mesh.faces, process=False)
    content = mesh.export(file_type=output.suffix.lower().lstrip("."))
    with atomic_path(output) as temporary:
        temporary.write_bytes(content if isinstance(content, bytes) else content.encode())


@click.command("preview", cls=Command)
@click.argument("shards", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=OutputFile(*DRAWINGS, *PAGES),
    default=Path("preview.png"),
    show_default=True,
    help="A picture (.png, .svg, .pdf), or a page with histograms, config and a scene in 3D (.html).",
)
@click.option("--frames", type=int, default=4, show_default=True, help="Frames to show, of different scenes.")
def preview_command(shards: Path, output: Path, frames: int) -> None:
    """Draw a contact sheet: depth, instances with their visibility, outlines and axes; or a whole page."""
    if not 1 <= frames <= 40:
        raise InputError(f"--frames {frames}: must be 1 to 40.")
    from evalkit.atomic import write_text
    from evalkit.datasets.shard_folder import ShardDataset
    from evalkit.drawing import page, plots
    from simgen.previews.preview_page import preview_page
    from simgen.previews.sheet import contact_sheet, spread_frames

    if output.suffix.lower() not in (*plots.SUFFIXES, *page.SUFFIXES):
        raise InputError(f"{output}: its name must end in {', '.join(plots.SUFFIXES)} or {page.SUFFIXES[0]}.")
    dataset = ShardDataset(shards)
    chosen = spread_frames(dataset, frames)
    if output.suffix.lower() in page.SUFFIXES:
        write_text(output, preview_page(dataset, chosen))
    else:
        plots.save(contact_sheet(dataset, chosen), output)
    click.echo(f"{output} written")


@click.command("view", cls=Command)
@click.argument("shards", type=click.Path(path_type=Path))
@click.option("--scenes", type=int, default=10, show_default=True, help="How many to show, from the first.")
@click.option("--save", "recording", type=OutputFile(".rrd"), help="Write a recording (.rrd), open no window.")
def view_command(shards: Path, scenes: int, recording: Path | None) -> None:
    """Open scenes in the rerun viewer: instances, bin, cameras, depth, labels (pip install 'binpose-simgen[view]')."""
    if scenes < 1:
        raise InputError(f"--scenes {scenes}: must be 1 or more.")
    import numpy as np

    from evalkit.datasets.shard_folder import ShardDataset
    from simgen.previews.rerun import open_viewer, save_recording

    dataset = ShardDataset(shards)
    frames = np.flatnonzero(np.isin(dataset.scene_index, np.unique(dataset.scene_index)[:scenes])).tolist()
    if recording is None:
        open_viewer(dataset, frames)
        return
    save_recording(dataset, frames, recording)
    click.echo(f"{recording} written; open it with: rerun {recording}")


@click.command("verify", cls=Command)
@click.argument("shards", type=click.Path(path_type=Path))
@click.option("--repair", is_flag=True, help="Rebuild what is damaged or missing, to the bytes that it had.")
@workers_option
def verify_command(shards: Path, repair: bool, workers: int) -> None:
    """Check every checksum and every label law; exit code 2 where one is broken, and was not repaired."""
    found = _verified(shards)
    if found and repair:
        _repair(shards, workers)
        found = _verified(shards)
    elif found and shards.is_dir():
        click.echo(f"'simgen verify --repair {shards}' rebuilds what is damaged or missing.", err=True)
    if found:
        raise click.exceptions.Exit(EXIT_BAD_INPUT)


def _verified(shards: Path) -> bool:
    """Check and print what was found; returns whether there are problems."""
    from tqdm import tqdm

    from simgen.building.verify import verify_shards

    with tqdm(desc="verify", unit=" shards", disable=None) as progress:
        report = verify_shards(shards, on_shard=lambda _: progress.update())
    for problem in report.problems[:MOST_PROBLEMS]:
        click.echo(str(problem), err=True)
    if len(report.problems) > MOST_PROBLEMS:
        click.echo(f"… and {len(report.problems) - MOST_PROBLEMS} more", err=True)
    click.echo(f"{shards}: {report.summary}")
    return bool(report.problems)


def _repair(shards: Path, workers: int) -> None:
    if not shards.is_dir():
        raise InputError(f"{shards}: --repair needs the folder of the dataset; give that.")
    from evalkit.datasets.shard_folder import shard_name
    from simgen.building.repair import repair

    report, warnings = repair(shards, workers)
    for warning in warnings:
        click.echo(f"Warning: {warning}", err=True)
    for name in sorted(shard_name(done.shard) for done in report.written):
        click.echo(f"{name} {'was damaged and' if name in report.damaged else 'was missing and'} has been rebuilt.")


def describe_object(prepared: PreparedObject) -> dict[str, Any]:
    """All that `simgen object` prints, as a document: lengths in millimeters, volumes in cubic centimeters."""
    from simgen.objects.winding import signed_volume

    model, mesh, symmetry = prepared.model, prepared.mesh, prepared.symmetry
    parts_volume = sum(signed_volume(vertices, faces) for vertices, faces in prepared.convex_parts)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    return {
        "name": model.name,
        "notes": model.notes,
        "units_reason": prepared.units_reason,
        "size_mm": _rounded(1e3 * (high - low)),
        "diameter_mm": _rounded(1e3 * model.diameter),
        "centroid_mm": _rounded(1e3 * model.centroid),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "components": mesh.components,
        "watertight": mesh.is_watertight,
        "volume_cm3": _rounded(1e6 * mesh.volume) if mesh.is_watertight else None,
        "symmetry": model.symmetry.to_json(),
        "symmetry_residual_mm": _rounded(1e3 * symmetry.residual),
        "symmetry_residual_of_diameter": _rounded(symmetry.relative_residual),
        "symmetry_tried": [
            {
                "name": candidate.symmetry.name,
                "axis": _rounded(candidate.symmetry.axis),
                "typical_mm": _rounded(1e3 * candidate.typical),
                "worst_mm": _rounded(1e3 * candidate.worst),
                "times_tolerance": _rounded(candidate.excess),
            }
            for candidate in symmetry.candidates
        ],
        "convex_parts": len(prepared.convex_parts),
        "convex_volume_over_mesh": _rounded(parts_volume / mesh.volume) if mesh.is_watertight else None,
        "warnings": prepared.warnings,
    }


def _as_text(document: dict[str, Any]) -> str:
    """The document in aligned lines."""
    notes, found = document["notes"], document["symmetry_tried"]
    sides = " x ".join(f"{side:g}" for side in document["size_mm"])
    scaled = "" if notes["scale"] == 1.0 else f", times {notes['scale']:g}"
    sound = "watertight" if document["watertight"] else "not watertight"
    volume = "" if document["volume_cm3"] is None else f", {document['volume_cm3']:g} cm3"
    ratio = document["convex_volume_over_mesh"]
    lines = [
        ("object", f"{document['name']} ({notes.get('origin', notes['source'])})"),
        ("units", f"{notes['units']}{scaled}: {document['units_reason']}"),
        ("size", f"{sides} mm, diameter {document['diameter_mm']:g} mm about the centroid"),
        ("centroid", ", ".join(f"{x:g}" for x in document["centroid_mm"]) + " mm"),
        ("mesh", f"{document['vertices']} vertices, {document['faces']} faces in {_pieces(document['components'])}"),
        ("soundness", f"{sound}{volume}"),
        ("symmetry", _symmetry_line(document)),
        *(("  tried", _tried_line(candidate)) for candidate in found),
        (
            "convex parts",
            f"{document['convex_parts']}" + ("" if ratio is None else f", {ratio:g} of the mesh's volume"),
        ),
        *(("warning", sentence) for sentence in document["warnings"]),
    ]
    return "\n".join(f"{name + ':':14}{text}" for name, text in lines)


def _symmetry_line(document: dict[str, Any]) -> str:
    name = document["symmetry"]["name"]
    if name == "none":
        return "none"
    axis = ", ".join(f"{row[2] + 0.0:.4g}" for row in document["symmetry"]["obj_from_sym"])
    share = 100 * document["symmetry_residual_of_diameter"]
    about = "" if name == "sphere" else f" about ({axis})"
    return f"{name}{about}, residual {document['symmetry_residual_mm']:g} mm ({share:.2g} % of the diameter)"


def _tried_line(candidate: dict[str, Any]) -> str:
    verdict = (
        "holds" if candidate["times_tolerance"] <= 1 else f"{candidate['times_tolerance']:.2g} times the tolerance"
    )
    return (
        f"{candidate['name']}: 99 % of the turned surface within {candidate['typical_mm']:.3g} mm, "
        f"worst {candidate['worst_mm']:.3g} mm; {verdict}"
    )


def _pieces(components: int) -> str:
    return "one piece" if components == 1 else f"{components} pieces"


def _rounded(value: Any) -> Any:
    """Numbers to six significant digits, arrays as lists."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return [_rounded(item) for item in value] if isinstance(value, list) else float(f"{value:.6g}") + 0.0
