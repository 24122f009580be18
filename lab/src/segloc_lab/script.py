"""What the modules that run as scripts share."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path


def parser(doc: str | None) -> argparse.ArgumentParser:
    """A parser that shows a module's docstring as its help."""
    return argparse.ArgumentParser(
        description=(doc or "").strip(), formatter_class=argparse.RawDescriptionHelpFormatter
    )


def storing(doc: str | None) -> argparse.ArgumentParser:
    """The same of a script whose table can be kept where results are."""
    options = parser(doc)
    options.add_argument("--store", type=Path, help="a folder of stored results")
    return options


def resumed(doc: str | None, out: str) -> argparse.ArgumentParser:
    """The same of a run that keeps what it has done in a file, and of several can be added up."""
    options = storing(doc)
    options.add_argument("--out", type=Path, default=Path(out))
    options.add_argument("--report", type=Path, nargs="+", help="what earlier runs have kept")
    return options


def shown(path: Path) -> str:
    """A path as a command that is kept with a result names it: as it was given, or its name."""
    return path.name if path.is_absolute() else path.as_posix()


def head(*columns: str) -> str:
    """The head of a Markdown table."""
    return f"{row(*columns)}\n{row(*('---' for _ in columns))}"


def row(*cells: object) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def show(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a Markdown table."""
    print(head(*columns))
    for cells in rows:
        print(row(*cells), flush=True)
