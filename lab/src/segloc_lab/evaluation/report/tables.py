"""Tables as text: for people, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math

from .study import Cell, Table

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
}


def text(cell: Cell) -> str:
    """A cell for people: at most four significant digits, a dash where there is nothing."""
    if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
        return "-"
    if not isinstance(cell, float):
        return str(cell)
    if cell == 0:
        return "0"
    digits = max(0, 3 - max(0, math.floor(math.log10(abs(cell))) + 1))
    return f"{cell:.{digits}f}"


def plain(table: Table) -> str:
    """Lines for a terminal: words to the left, numbers to the right."""
    rows = [list(table.columns), *([text(cell) for cell in row] for row in table.rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(table.columns))]
    words = [k == 0 or not _numeric(table, k) for k in range(len(table.columns))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if left else cell.rjust(width)
            for cell, width, left in zip(row, widths, words, strict=True)
        ).rstrip()
        for row in rows
    )


def to_csv(table: Table) -> str:
    """Every digit of every cell after RFC 4180, with a header; empty where there is nothing."""
    stream = io.StringIO()
    writer = csv.writer(stream)
    writer.writerow(table.columns)
    writer.writerows(["" if cell is None else cell for cell in row] for row in table.rows)
    return stream.getvalue()


def to_latex(table: Table) -> str:
    """A ``table`` environment that needs no package but booktabs."""
    layout = "".join("r" if _numeric(table, k) else "l" for k in range(len(table.columns)))
    title = f"{table.title} (as published)" if table.source == "paper" else table.title
    caption = " ".join(part for part in (f"{title}.", table.note) if part)
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{escape(caption)}}}",
            rf"  \label{{tab:{table.name}}}",
            rf"  \begin{{tabular}}{{{layout}}}",
            r"    \toprule",
            "    " + _line(table.columns),
            r"    \midrule",
            *("    " + _line([text(cell) for cell in row]) for row in table.rows),
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def escape(plain: str) -> str:
    """Plain text as LaTeX that prints it."""
    return "".join(_LATEX.get(character, character) for character in plain)


def _line(cells: tuple[str, ...] | list[str]) -> str:
    return " & ".join(map(escape, cells)) + r" \\"


def _numeric(table: Table, column: int) -> bool:
    cells = [row[column] for row in table.rows]
    return any(isinstance(cell, (int, float)) for cell in cells) and not any(
        isinstance(cell, str) for cell in cells
    )
