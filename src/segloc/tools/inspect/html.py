"""Pages of one file, with text, tables and pictures: for any browser, without a server."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

STYLE = """
:root { color-scheme: light }
body { font: 16px/1.5 system-ui, sans-serif; color: #222b38; background: #fff; max-width: 1260px;
  margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.5em } h2 { font-size: 1.15em; margin: 1.6em 0 .4em }
h3 { font-size: 1em; margin: 1em 0 .2em; color: #59637a }
h1, h2, h3, p, figcaption { overflow-wrap: anywhere }
.good, .bad { font-weight: 600 } .good { color: #0d7a3c } .bad { color: #b81d30 }
.tables { overflow-x: auto } table { border-collapse: collapse }
th { text-align: left; font-weight: 600; border-bottom: 1px solid #dde2ea }
td, th { padding: .15em 1em .15em 0; vertical-align: top; white-space: pre-wrap;
  font-variant-numeric: tabular-nums }
.pictures { display: grid; gap: 1em; margin: 1.2em 0;
  grid-template-columns: repeat(auto-fit, minmax(min(380px, 100%), 1fr)) }
.wide { grid-template-columns: 1fr }
figure { margin: 0; max-width: 640px } .wide figure { max-width: none }
img { width: 100%; box-sizing: border-box; border: 1px solid #dde2ea }
figcaption { font-size: .85em; color: #59637a }
"""


def document(heading: str, summary: str, good: bool, *body: str) -> str:
    """Return a page.

    Parameters
    ----------
    heading : str
    summary : str
        One line below the heading, green if ``good``, else red.
    body : HTML
    """
    kind = "good" if good else "bad"
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(heading)}</title><style>{STYLE}</style><h1>{escape(heading)}</h1>"
        f'<p class="{kind}">{escape(summary)}</p>{"".join(body)}</html>\n'
    )


def heading(text: str) -> str:
    """Return a heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def paragraphs(lines: Sequence[str]) -> str:
    """Return a paragraph for each line."""
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def table(rows: Sequence[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Return a table; "" without rows."""
    if not rows:
        return ""
    names = "".join(f"<th>{escape(name)}</th>" for name in header)
    lines = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows)
    cells = "".join(f"<tr>{line}</tr>" for line in lines)
    head = f"<tr>{names}</tr>" if names else ""
    return f'<div class="tables"><table>{head}{cells}</table></div>'


def pictures(captioned: Sequence[tuple[str, bytes]], *, wide: bool = False) -> str:
    """Return PNG images with their captions, side by side, or ``wide`` below each other."""
    figures = "".join(
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,'
        f'{base64.b64encode(image).decode()}"><figcaption>{escape(caption)}</figcaption></figure>'
        for caption, image in captioned
    )
    return f'<div class="pictures{" wide" if wide else ""}">{figures}</div>' if figures else ""
