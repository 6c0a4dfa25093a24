"""A check as one HTML page: the findings, what to do, and the poses over the images to look at."""

from __future__ import annotations

from pathlib import Path

import cv2

from evalkit.atomic import write_text
from evalkit.drawing.page import render_page
from evalkit.evidence.verdict import Verdict
from evalkit.evidence.verdict_picture import caption, draw_verdicts
from posenet.checking.advice import OLDER, VERDICTS, Finding, Grade, worst
from posenet.checking.site import LookedAt, Site

QUALITY = 88  # of JPEG
CLASSES = {Grade.FINE: "yes", Grade.DOUBTFUL: "unknown", Grade.BAD: "no"}
WORDS = {Grade.FINE: "fine", Grade.DOUBTFUL: "doubtful", Grade.BAD: "bad"}


def save_page(path: Path, site: Site, found: list[Finding], model: Path, frames: Path) -> None:
    """Write the page; it needs no network.

    Raises:
        OSError: it cannot be written.
    """
    verified, contradicted, undecided = (site.count(verdict) for verdict in Verdict)
    near, far = site.distance
    tiles = [
        ("verified parts", str(verified), f"on {len(site.images)} images"),
        ("contradicted poses", str(contradicted), f"{undecided} undecided"),
        ("of the heap explained", f"{site.explained:.0%}", "by verified poses"),
        ("distance", f"{near:.2f} to {far:.2f} m", f"a part {site.pixels[0]:.0f} pixels or more"),
    ]
    rows = [(one, "soft", "not compared") if one.trained == OLDER else (one, CLASSES[one.grade], WORDS[one.grade])
            for one in found]  # fmt: skip
    overlays = [(caption(image.found), _jpeg(image, site)) for image in site.images]
    page = render_page(
        "posenet.checking", "check.html", object=site.model, model=model.name, frames=frames.name or str(frames),
        verdict=VERDICTS[worst(found)], tiles=tiles, rows=rows, overlays=overlays,
    )  # fmt: skip
    write_text(path, page)


def _jpeg(image: LookedAt, site: Site) -> bytes:
    picture = draw_verdicts(image.depth, image.camera, site.model, image.found)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())
