"""A trace as one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from ..map.segment_map import SegmentMap
from .drawing import pictures
from .trace import Trace
from .words import steps, verdict

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222b38; max-width: 1260px; margin: 2em auto;
  padding: 0 1em }
h1 { font-size: 1.5em } h2 { font-size: 1.15em; margin: 1.6em 0 .4em }
.found, .lost { font-weight: 600 } .found { color: #0d7a3c } .lost { color: #b81d30 }
table { border-collapse: collapse } td { padding: .15em 1em .15em 0; vertical-align: top }
td.number { text-align: right; font-variant-numeric: tabular-nums }
.pictures { display: grid; gap: 1em; margin: 1.2em 0;
  grid-template-columns: repeat(auto-fill, minmax(min(380px, 100%), 1fr)) }
figure { margin: 0 } img { width: 100%; box-sizing: border-box; border: 1px solid #dde2ea }
figcaption { font-size: .85em; color: #59637a }
"""


def page(trace: Trace, prior_map: SegmentMap, findings: Sequence[str]) -> str:
    """HTML with the verdict, each stage in words and pictures, and the parts of the confidence.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    kind = "found" if trace.result.localized else "lost"
    figures = "".join(
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,'
        f'{base64.b64encode(image).decode()}"><figcaption>{escape(caption)}</figcaption></figure>'
        for caption, image in pictures(trace, prior_map)
    )
    parts = [(f"{part.log_odds:+.1f}", part.words) for part in trace.parts]
    if parts:
        parts.insert(0, (f"{trace.constant:+.1f}", "to begin with: most poses are wrong"))
    noted = "".join(f"<p>{escape(line)}</p>" for line in findings)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(trace.name)}</title>"
        f"<style>{_STYLE}</style><h1>{escape(trace.name)}</h1>"
        f'<p class="{kind}">{escape(verdict(trace))}</p>{noted}'
        f"<h2>Stage by stage</h2>{_table(steps(trace))}"
        f'<div class="pictures">{figures}</div>'
        f"<h2>What the confidence is made of</h2>{_table(parts, 'number')}</html>"
    )


def _table(rows: Sequence[tuple[str, str]], kind: str = "name") -> str:
    cells = (
        f'<tr><td class="{kind}">{escape(first)}</td><td>{escape(second)}</td></tr>'
        for first, second in rows
    )
    return f"<table>{''.join(cells)}</table>"
