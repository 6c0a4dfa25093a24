"""What our HTML pages are made of: one file that needs no network, and its tiles, charts and tables.

Words are escaped here, except where an argument is said to be HTML.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np

from evalkit.drawing.chart import Chart
from evalkit.errors import InputError

SUFFIXES = (".html", ".htm")
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"  # a browser then loads nothing, by law


def require_page_name(path: Path | str) -> None:
    """Raises: InputError: the name is not that of an HTML page."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: the page's name must end in {' or '.join(SUFFIXES)}.")


def page(title: str, body: str, script: str = "") -> str:
    """The whole page: `body` is HTML, `script` JavaScript, the only one that a browser will run in it."""
    style = files("evalkit.drawing").joinpath("page.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}{_allowed(script)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
{body}
{f"<script>{script}</script>{chr(10)}" if script else ""}</body>
</html>
"""


def _allowed(script: str) -> str:
    if not script:
        return ""
    return f"; script-src 'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def tile(label: str, value: str, note: str = "") -> str:
    """A figure in large, for a ``<dl class="tiles">``."""
    small = f"<small>{escape(note)}</small>" if note else ""
    return f"<div><dt>{escape(label)}</dt><dd>{escape(value)}{small}</dd></div>"


def chart_figure(chart: Chart) -> str:
    """A chart with its title and caption."""
    return f"""<figure id="{chart.name}"><h3>{escape(chart.title)}</h3>
<img alt="{escape(chart.title)}" src="{data_uri("image/svg+xml", chart.svg())}">
<figcaption>{escape(chart.caption)}</figcaption></figure>
"""


def facts(entries: Iterable[tuple[str, str]]) -> str:
    """Names and values, both HTML, in two columns."""
    return f"""<dl class="facts">{"".join(f"<dt>{key}</dt><dd>{value}</dd>" for key, value in entries)}</dl>"""


def html_table(head: Sequence[str], rows: Iterable[Sequence[str | float]], style: str) -> str:
    """Cells are HTML; the first of a row is its heading; a float is shown with a bar."""
    columns = "".join(f"<th scope='col'>{escape(words)}</th>" for words in head)
    body = "".join(f"<tr><th scope='row'>{first}</th>{''.join(map(_cell, rest))}</tr>" for first, *rest in rows)
    top = f"<thead><tr>{columns}</tr></thead>" if head else ""
    return f"<div class='scroll'><table class='{style}'>{top}<tbody>{body}</tbody></table></div>"


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return f"<td>{value}</td>"
    share = 0.0 if np.isnan(value) else value
    return f"<td class='bar' style='--share: {share:.4f}'>{decimals(value)}</td>"


def decimals(value: float) -> str:
    """Three decimals, or a dash for NaN."""
    return "–" if np.isnan(value) else f"{value:.3f}"


def counted(count: int, noun: str) -> str:
    """Such as "1 image" and "2 images"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def data_uri(kind: str, content: bytes) -> str:
    """`content` inside a ``src``, of media type `kind`."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
