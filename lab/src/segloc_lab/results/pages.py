"""Tables of the documentation, generated from stored results.

A page shows a result where it says ``<!-- begin result NAME -->`` and ``<!-- end result NAME -->``.
Below each table stands what measured it, and whether that code is still the one of this clone. A
table from before there were stored results stays, marked, until its result is stored; so does a
remark that there is none yet. ``<!-- begin result NAME, bold where METHOD is behind -->`` prints
those rows in bold in which a column of another method has more than that of METHOD. Sentences
that quote a result are in :mod:`.quotes`; one that is not as it is stored is a fault, too.

    python -m segloc_lab.results.pages --check
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..evaluation.methods import METHODS
from ..script import parser
from .fingerprints import PROJECT, brought_forward, changed, changes_without_effect_on
from .quotes import unsaid
from .store import FOLDER, Cell, Result

DOCS = PROJECT / "docs"
_PLACE = re.compile(
    r"(?P<begin><!-- begin result (?P<name>[\w-]+)"
    r"(?:, bold where (?P<ours>[\w-]+) is behind)? -->\n)"
    r"(?P<body>.*?)(?P<end><!-- end result (?P=name) -->)",
    flags=re.DOTALL,
)
MARK = "*Not kept with its code, so it may be outdated.*"
"""Of a table that is shown until its result is stored."""

UNMEASURED = "*Not measured so far.*"
"""In place of a table until its result is stored."""

_NUMBER = re.compile(r"\d+(\.\d+)?")

_STATUS = re.compile(r"^\*(?:Measured at|Outdated:).*$", flags=re.MULTILINE)


def table(result: Result, ours: str | None = None) -> str:
    """A result as Markdown, with its note and its command; in bold where a method is behind."""
    head = (result.columns, ("---",) * len(result.columns))
    rows = [[_shown(cell) for cell in row] for row in (*head, *result.rows)]
    note = f"{result.note}\n\n" if result.note else ""
    if ours is not None:
        behind = [k for k, row in enumerate(result.rows, len(head)) if _behind(result, row, ours)]
        for k in behind:
            rows[k] = [f"**{cell}**" for cell in rows[k]]
        note += f"Bold: another method is ahead of `{ours}`.\n\n" if behind else ""
    lines = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"    {result.command}\n\n{lines}\n\n{note}"


def _behind(result: Result, row: Sequence[Cell], ours: str) -> bool:
    """Whether a column of another method has more, as a number or the one that a text begins."""
    cells = zip(result.columns, row, strict=True)
    scores = {name: _NUMBER.match(str(cell)) for name, cell in cells if name in METHODS}
    numbers = {name: float(found[0]) for name, found in scores.items() if found}
    return max(numbers.values()) > numbers[ours]


def _shown(cell: Cell) -> str:
    return "-" if cell is None else f"{cell:g}" if isinstance(cell, float) else str(cell)


def status(result: Result, root: Path = PROJECT) -> str:
    """One line: the commit, and what has changed since."""
    harmless = changes_without_effect_on(result.name, root)
    produced_by, made = brought_forward(result.produced_by, harmless)
    gone = changed(produced_by, root)
    if gone:
        return f"*Outdated: measured at {result.commit}; changed since: {', '.join(gone)}.*"
    concerned = " and ".join(change.concerns for change in made)
    but = f", but what concerns only {concerned}" if made else ""
    return f"*Measured at {result.commit}, and nothing that it depends on has changed since{but}.*"


def written(page: str, folder: Path = FOLDER, root: Path = PROJECT) -> str:
    """The page with all its results filled in anew.

    Raises
    ------
    FileNotFoundError
        If a result is not stored, and no table from before stands there, marked.
    """

    def filled(match: re.Match[str]) -> str:
        path, body = folder / f"{match['name']}.json", match["body"]
        if not path.exists() and (MARK in body or UNMEASURED in body):
            return match[0]
        result = Result.load(path)
        shown = f"{table(result, match['ours'])}{status(result, root)}"
        return f"{match['begin']}\n{shown}\n\n{match['end']}"

    return _PLACE.sub(filled, page)


def stale(page: str, folder: Path = FOLDER) -> list[str]:
    """Results that the page shows otherwise than they are stored; their age does not count."""
    shown = dict(zip(_names(page), _bodies(page), strict=True))
    stored = dict(zip(_names(page), _bodies(written(page, folder)), strict=True))
    return [name for name, body in shown.items() if _ageless(body) != _ageless(stored[name])]


def _names(page: str) -> list[str]:
    return [match["name"] for match in _PLACE.finditer(page)]


def _bodies(page: str) -> list[str]:
    return [match["body"] for match in _PLACE.finditer(page)]


def _ageless(body: str) -> str:
    return _STATUS.sub("", body)


def pages(docs: Path = DOCS) -> Iterator[Path]:
    """The pages that show a result."""
    for path in sorted(docs.rglob("*.md")):
        if _PLACE.search(path.read_text("utf-8")):
            yield path


def main() -> None:
    """Write all pages, or say what is stale and what is outdated."""
    arguments = parser(__doc__)
    arguments.add_argument("--check", action="store_true", help="exit status 1 if a page is stale")
    options = arguments.parse_args()
    faults = []
    for path in pages():
        text = path.read_text("utf-8")
        if options.check:
            faults += [f"{path.name}: {name} is not as it is stored" for name in stale(text)]
        else:
            path.write_text(written(text), "utf-8")
        for name in _names(text):
            stored = FOLDER / f"{name}.json"
            state = status(Result.load(stored)) if stored.exists() else "not stored"
            print(f"{path.name}: {name}: {state}")
    faults += [f'{page} should say, by stored results: "{text}"' for page, text in unsaid()]
    print("\n".join(faults))
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
