"""Stored studies -> one page of HTML, and each table as CSV and LaTeX."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import SeglocError
from ..files import write_text
from .study import Study
from .tables import to_csv, to_latex


def write(out: Path, studies: Sequence[Study]) -> None:
    """Write ``report.html`` and ``tables/NAME.csv`` and ``.tex`` to a folder.

    Raises
    ------
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
