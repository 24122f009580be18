"""Command lines of the modules that run as scripts, and the files from which long runs go on."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .report import new_folder


def parser(doc: str | None) -> argparse.ArgumentParser:
    """Make a parser that shows a module's docstring as its help."""
    return argparse.ArgumentParser(
        description=(doc or "").strip(), formatter_class=argparse.RawDescriptionHelpFormatter
    )


def reporting(doc: str | None) -> argparse.ArgumentParser:
    """Make a parser with an option for the folder of the report."""
    options = parser(doc)
    options.add_argument(
        "--report", type=new_folder, metavar="FOLDER", help="new folder for a dated report"
    )
    return options


def resumed(doc: str | None, out: str) -> argparse.ArgumentParser:
    """Make the parser of a run that goes on from its file, and that adds up files of others."""
    options = reporting(doc)
    options.add_argument("--out", type=Path, default=Path(out))
    options.add_argument(
        "--add", type=Path, nargs="+", metavar="FILE", help="add up files of earlier runs, only"
    )
    return options


def entries(path: Path) -> list[dict[str, Any]]:
    """Read the lines of JSON that a run has kept, in order."""
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def keep(path: Path, entry: Mapping[str, Any]) -> None:
    """Append a line of JSON to a file, which need not exist."""
    with path.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(entry) + "\n")


def head(*columns: str) -> str:
    """Format the head of a Markdown table."""
    return f"{row(*columns)}\n{row(*('---' for _ in columns))}"


def row(*cells: object) -> str:
    """Format a row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def show(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a Markdown table, row by row."""
    print(head(*columns))
    for cells in rows:
        print(row(*cells), flush=True)
