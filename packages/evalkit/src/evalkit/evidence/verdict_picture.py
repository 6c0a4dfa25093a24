"""A contact sheet of verdicts: outlines of the poses over the depth images, in the color of what the image says."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.drawing.overlays import GREEN, RED, WHITE, Color, Image, draw_poses, shade
from evalkit.errors import InputError
from evalkit.evidence.verdict import Verdict
from evalkit.evidence.verification import VerifiedImage
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

AMBER, VIOLET, BLACK = (40, 170, 250), (230, 90, 190), (0, 0, 0)  # BGR
COLORS: dict[Verdict, Color] = {Verdict.VERIFIED: GREEN, Verdict.CONTRADICTED: RED, Verdict.UNDECIDED: AMBER}
MEANING = "green: verified, red: contradicted, amber: undecided, violet: a part counted already"
TILE = 520  # pixels, the longer side of an image on the sheet
MARGIN = 0.05  # of the seen part's sides, around it
CAPTION, GAP = 26, 6  # pixels


def draw_verdicts(depth: NDArray[np.float32], camera: Camera, model: ObjectModel, image: VerifiedImage) -> Image:
    """What was seen of one depth image (height, width) in meters, with its poses, as (…, …, 3), BGR; see MEANING."""
    x0, y0, x1, y1 = seen_part(depth)
    scale = max(1, min(4, round(2 * TILE / max(x1 - x0, y1 - y0))))
    picture = shade(depth, camera, scale)
    for verdict in (Verdict.UNDECIDED, Verdict.VERIFIED, Verdict.CONTRADICTED):
        rows = [n for n, part in enumerate(image.evidence) if part.verdict is verdict]
        colors = [VIOLET if image.duplicate_of[n] is not None else COLORS[verdict] for n in rows]
        picture = draw_poses(depth, camera, model, image.cam_from_obj[rows], colors, scale, max(1, scale), picture)
    return picture[y0 * scale : y1 * scale, x0 * scale : x1 * scale]


def seen_part(depth: NDArray[np.float32]) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 around the pixels with a return, a margin included; the whole image where there are none."""
    height, width = depth.shape
    rows, columns = np.flatnonzero((depth > 0).any(1)), np.flatnonzero((depth > 0).any(0))
    if len(rows) == 0:
        return 0, 0, width, height
    margin_y, margin_x = (int(MARGIN * (side[-1] - side[0])) + 2 for side in (rows, columns))
    x0, x1 = max(0, columns[0] - margin_x), min(width, columns[-1] + margin_x + 1)
    y0, y1 = max(0, rows[0] - margin_y), min(height, rows[-1] + margin_y + 1)
    return int(x0), int(y0), int(x1), int(y1)


def caption(image: VerifiedImage) -> str:
    """An image's name and counts."""
    verified, contradicted, undecided = (int(image.are(verdict).sum()) for verdict in Verdict)
    return f"{image.id}: {verified} verified, {contradicted} contradicted, {undecided} undecided"


def contact_sheet(tiles: Sequence[tuple[str, Image]], columns: int = 3) -> Image:
    """Captioned pictures (…, …, 3) side by side, each as large as fits its cell; one cell at least."""
    small = [(text, _fitted(picture)) for text, picture in tiles] or [("", np.zeros((TILE, TILE, 3), np.uint8))]
    height = max(picture.shape[0] for _, picture in small)
    cells = [_cell(text, picture, height) for text, picture in small]
    columns = min(columns, len(cells))
    cells += [np.zeros_like(cells[0])] * (-len(cells) % columns)
    return np.vstack([np.hstack(cells[start : start + columns]) for start in range(0, len(cells), columns)])


def write_sheet(path: Path, tiles: Iterable[tuple[str, Image]]) -> None:
    """Write a :func:`contact_sheet` as PNG.

    Raises:
        InputError: the name does not end in .png.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: the contact sheet is a PNG; end its name in .png.")
    with atomic_path(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", contact_sheet(list(tiles)))[1].tobytes())


def _fitted(picture: Image) -> Image:
    """A picture whose longer side is TILE."""
    height, width = picture.shape[:2]
    scale = TILE / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR))


def _cell(text: str, picture: Image, height: int) -> Image:
    """A tile with its caption, the picture in its middle."""
    tile = np.zeros((height + CAPTION, TILE + GAP, 3), np.uint8)
    top, left = CAPTION + (height - picture.shape[0]) // 2, (TILE + GAP - picture.shape[1]) // 2
    tile[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    cv2.putText(tile, text, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, WHITE, 1, cv2.LINE_AA)
    return tile
