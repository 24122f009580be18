"""Sentences of the documents that quote stored results.

``docs/quotes.yaml`` lists them by page: a text with ``{names}``, and for each name a stored result,
its rows, and a column. Rows are a pattern over the first cells, joined by " | "; counts of several
rows are added up. A page must hold the text with today's figures in it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import yaml

from segloc.errors import DatasetError

from .fingerprints import PROJECT
from .store import FOLDER, Cell, Result

QUOTES = PROJECT / "docs" / "quotes.yaml"
_COUNT = re.compile(r"(\d+)(?: of (\d+))?\b")
_WORDS = (
    *("none", "one", "two", "three", "four", "five", "six"),
    *("seven", "eight", "nine", "ten", "eleven", "twelve"),
)


@dataclass(frozen=True)
class Figure:
    """A count, or so many of so many.

    In a text ``{name}`` is all of it, ``{name.n}`` and ``{name.of}`` either number, and
    ``{name.word}`` the first one in letters.
    """

    number: float
    whole: int | None = None

    @property
    def n(self) -> str:
        return _spaced(self.number)

    @property
    def of(self) -> str:
        return _spaced(self.whole or 0)

    @property
    def word(self) -> str:
        return _WORDS[int(self.number)]

    @property
    def seconds(self) -> str:
        """Of milliseconds, to one digit."""
        return f"{self.number / 1000:.1g}"

    def __str__(self) -> str:
        return self.n if self.whole is None else f"{self.n} of {self.of}"


def _spaced(number: float) -> str:
    return f"{number:,}".replace(",", " ") if number >= 10_000 else str(number)


def figure(name: str, rows: str, column: str, folder: Path = FOLDER) -> Figure:
    """What the rows of a stored result have in a column, added up.

    Raises
    ------
    DatasetError
        If there is no such row or column, or something else than a count in it.
    """
    result = Result.load(folder / f"{name}.json")
    found = [row for row in result.rows if fnmatchcase(_label(row), f"{rows} | *")]
    if column not in result.columns or not found:
        raise DatasetError(f"{name}: no row {rows!r} with a column {column!r}")
    figures = [_read(row[result.columns.index(column)], name) for row in found]
    wholes = [each.whole for each in figures if each.whole is not None]
    return Figure(sum(each.number for each in figures), sum(wholes) if wholes else None)


def _label(row: tuple[Cell, ...]) -> str:
    return " | ".join(f"{cell:g}" if isinstance(cell, float) else str(cell) for cell in row) + " | "


def _read(cell: Cell, name: str) -> Figure:
    if isinstance(cell, (int, float)):
        return Figure(cell)
    match = _COUNT.match(cell or "")
    if match is None:
        raise DatasetError(f"{name}: {cell!r} is no count")
    return Figure(int(match[1]), None if match[2] is None else int(match[2]))


def unsaid(
    quotes: Path = QUOTES, folder: Path = FOLDER, project: Path = PROJECT
) -> Iterator[tuple[str, str]]:
    """Page and sentence of what pages should say, and do not."""
    for page, sentences in yaml.safe_load(quotes.read_text("utf-8")).items():
        said = " ".join((project / page).read_text("utf-8").split())
        for sentence in sentences:
            text = _filled(sentence, folder)
            if text not in said:
                yield page, text


def _filled(sentence: Mapping[str, str | list[str]], folder: Path) -> str:
    looked_up = {
        name: figure(where[0], where[1], where[2], folder)
        for name, where in sentence.items()
        if name != "text"
    }
    return str(sentence["text"]).format(**looked_up)
