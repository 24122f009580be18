"""Stored studies -> one page of HTML, and each table as CSV and LaTeX."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from segloc.errors import SeglocError
from segloc.system.files import write_text

from .drawing import svg
from .study import Cell, Figure, Study, Table
from .tables import text, to_csv, to_latex

INTRODUCTION = (
    "segloc tells where a LiDAR is in a map that was made before: it cuts one point cloud into "
    "segments (a tree, a car, a piece of wall), describes each by a few numbers, looks for the "
    "segments of the map that have similar numbers, and finds the pose that many of these matches "
    "agree on. The studies below compare ways of describing a segment: those of Tinchev, "
    "Penate-Sanchez and Fallon, “Real-time LIDAR localization in natural and urban "
    "environments” (arXiv 2301.13583), and segloc's own. Wherever the paper gives figures, they "
    "stand beside ours and are marked as published."
)

_FACTS = {
    "command": "Command",
    "suite": "Test sets",
    "scale": "Scale",
    "seed": "Seed",
    "threads": "Threads",
    "workers": "Processes",
    "data": "Recorded data",
    "fingerprints": "Fingerprints of the weights",
    "versions": "Versions",
    "machine": "Machine",
    "seconds": "Seconds",
}


def write(out: Path, studies: Sequence[Study]) -> None:
    """Write ``report.html`` and ``tables/NAME.csv`` and ``.tex`` to a folder.

    Raises
    ------
    MissingDependency
        If a figure is to be drawn and matplotlib is not installed; the tables are written.
    SeglocError
        If a file cannot be written.
    """
    folder = out / "tables"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SeglocError(f"{folder}: cannot be made: {error.strerror or error}") from error
    for study in studies:
        for table in study.tables:
            write_text(folder / f"{study.name}-{table.name}.csv", to_csv(table))
            write_text(folder / f"{study.name}-{table.name}.tex", to_latex(table))
    write_text(out / "report.html", page(studies))


def page(studies: Sequence[Study]) -> str:
    """One HTML page that needs nothing beside itself.

    Raises
    ------
    MissingDependency
        If a figure is to be drawn and matplotlib is not installed.
    """
    links = "".join(f'<a href="#{escape(s.name)}">{escape(s.title)}</a>' for s in studies)
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            "<title>segloc: evaluation</title>",
            f"<style>{_STYLE}</style>",
            "</head>",
            "<body>",
            "<header>",
            "<h1>segloc: evaluation</h1>",
            f"<p>{escape(INTRODUCTION)}</p>",
            f"<nav>{links}</nav>",
            "</header>",
            "<main>",
            *(part for study in studies for part in _section(study)),
            "</main>",
            "</body>",
            "</html>",
            "",
        ]
    )


def _section(study: Study) -> Iterator[str]:
    yield f'<section id="{escape(study.name)}">'
    yield f"<h2>{escape(study.title)}</h2>"
    for paragraph in filter(None, (part.strip() for part in study.text.split("\n\n"))):
        yield f"<p>{escape(paragraph)}</p>"
    for table in study.tables:
        yield from _table(table)
    if study.figures:
        yield '<div class="figures">'
        for fold, figures in groupby(study.figures, lambda figure: figure.fold):
            drawn = (part for figure in figures for part in _figure(study, figure))
            yield from _folded(fold, drawn) if fold else drawn
        yield "</div>"
    yield from _facts(study.facts)
    yield "</section>"


def _table(table: Table) -> Iterator[str]:
    published = table.source == "paper"
    long = len(table.rows) > _LONG_ROWS
    if long:
        yield f"<details><summary>{escape(table.title)} ({len(table.rows)} rows)</summary>"
    mark = ' <span class="badge">published</span>' if published else ""
    yield f'<div class="scroll"><table class="{"paper" if published else "ours"}">'
    yield f"<caption>{escape(table.title)}{mark}</caption>"
    yield "<thead><tr>" + "".join(f"<th>{escape(c)}</th>" for c in table.columns) + "</tr></thead>"
    yield "<tbody>"
    for row in table.rows:
        head = f'<th scope="row">{escape(text(row[0]))}</th>'
        yield "<tr>" + head + "".join(map(_cell, row[1:])) + "</tr>"
    yield "</tbody></table></div>"
    if table.note:
        yield f'<p class="note">{escape(table.note)}</p>'
    if long:
        yield "</details>"


_LONG_ROWS = 30


def _cell(cell: Cell) -> str:
    words = isinstance(cell, str) and not cell[:1].isdigit()
    return f"<td{' class=words' if words else ''}>{escape(text(cell))}</td>"


def _folded(title: str, parts: Iterable[str]) -> Iterator[str]:
    yield f'<details class="fold"><summary>{escape(title)}</summary><div class="figures">'
    yield from parts
    yield "</div></details>"


def _figure(study: Study, figure: Figure) -> Iterator[str]:
    yield f'<figure class="{figure.kind}" id="{escape(f"{study.name}-{figure.name}")}">'
    yield svg(figure, f"{study.name}-")
    note = f" <span>{escape(figure.note)}</span>" if figure.note else ""
    yield f"<figcaption>{escape(figure.title)}{note}</figcaption>"
    yield "</figure>"


def _facts(facts: Mapping[str, Any]) -> Iterator[str]:
    if not facts:
        return
    command = facts.get("command")
    if command:
        yield f"<p>Made by <code>{escape(str(command))}</code></p>"
    yield "<details><summary>How this was made</summary><dl>"
    for key, value in facts.items():
        if value is not None and value != {}:
            yield f"<dt>{escape(_FACTS.get(key, key))}</dt><dd>{_value(value)}</dd>"
    yield "</dl></details>"


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "<br>".join(
            f"{escape(str(k))}: <code>{escape(str(v))}</code>" for k, v in value.items()
        )
    return escape(str(value))


_STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --soft: #5c6878; --line: #d9dee6;
  --paper: #fff; --tint: #f5f7fa; --accent: #2563b8; --badge: #8a5a00; --badge-bg: #fff3d6; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #dde3ec; --soft: #96a2b4; --line: #333c4a; --paper: #14181f; --tint: #1b212b;
    --accent: #7db1f5; --badge: #f0c674; --badge-bg: #3a3019; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.25rem 5rem; max-width: 70rem; background: var(--paper);
  color: var(--ink); font: 16px/1.6 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.45rem; margin: 0 0 .75rem; }
p { max-width: 46rem; }
section { margin-top: 3rem; padding-top: 2rem; border-top: 1px solid var(--line); }
nav { display: flex; flex-wrap: wrap; gap: .4rem 1.2rem; }
a { color: var(--accent); text-decoration: none; }
a:hover { text-decoration: underline; }
code { font: .85em/1.5 ui-monospace, "SF Mono", Menlo, Consolas, monospace; background: var(--tint);
  padding: .1em .35em; border-radius: 4px; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; margin: 1.5rem 0 .5rem; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .5rem; font-size: 1rem; }
th, td { padding: .35rem .8rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
thead th { color: var(--soft); font-weight: 600; border-bottom: 2px solid var(--line);
  white-space: normal; max-width: 7.5rem; vertical-align: bottom; }
th:first-child, td.words { text-align: left; }
tbody th { font-weight: 500; }
tbody tr:hover { background: var(--tint); }
table.paper { color: var(--soft); }
table.paper caption { color: var(--ink); }
.badge { font-size: .72rem; font-weight: 600; color: var(--badge); background: var(--badge-bg);
  border-radius: 999px; padding: .15em .7em; margin-left: .4em; vertical-align: middle; }
.note, figcaption span { color: var(--soft); font-size: .88rem; margin-top: .25rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr));
  gap: 1.5rem; margin: 1.5rem 0; }
.fold { grid-column: 1 / -1; }
figure { margin: 0; padding: 1rem; background: var(--tint); border-radius: 10px; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { font-size: .9rem; font-weight: 600; margin-top: .5rem; }
figcaption span { display: block; font-weight: 400; }
details { margin: 1rem 0; }
summary { cursor: pointer; color: var(--accent); }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .3rem 1.2rem; font-size: .88rem; }
dt { color: var(--soft); }
dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 40rem) { dl { grid-template-columns: 1fr; } dd { margin-bottom: .5rem; } }
@media print { body { max-width: none; } figure { break-inside: avoid; } }
"""
