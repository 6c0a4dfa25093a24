"""What our HTML pages share: one file that needs no network, its style, and its tiles, charts and tables.

Pages are Jinja2 templates that extend ``page.html``; ``parts.html`` holds the macros. Words are escaped unless they
are `markupsafe.Markup`.
"""

from __future__ import annotations

import base64
import hashlib
import math
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from evalkit.errors import InputError

SUFFIXES = (".html", ".htm")
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"  # a browser then loads nothing, by law


def require_page_name(path: Path | str) -> None:
    """Raises: InputError: the name is not that of an HTML page."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: the page's name must end in {' or '.join(SUFFIXES)}.")


def render_page(room: str, template: str, script: str = "", **content: Any) -> str:
    """A page from `template`, which lies in ``templates/`` of the package `room`.

    Args:
        script: JavaScript, the only one that a browser will run in the page.
        content: what the template refers to.
    """
    loader = ChoiceLoader([PackageLoader(room), PackageLoader("evalkit.drawing")])
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"counted": counted, "data_uri": data_uri, "decimals": decimals, "share": _share}
    return environment.get_template(template).render(policy=Markup(POLICY + _allowed(script)), script=script, **content)


def _allowed(script: str) -> str:
    if not script:
        return ""
    return f"; script-src 'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def decimals(value: float) -> str:
    """Three decimals, or a dash for NaN."""
    return "–" if math.isnan(value) else f"{value:.3f}"


def _share(value: float) -> str:
    """The length of a table's bar, as CSS takes it."""
    return f"{0.0 if math.isnan(value) else value:.4f}"


def counted(count: int, noun: str) -> str:
    """Such as "1 image" and "2 images"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def data_uri(content: bytes, kind: str) -> str:
    """`content` inside a ``src``, of media type `kind`."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
