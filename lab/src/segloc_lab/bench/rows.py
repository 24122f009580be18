"""Rows of measurements as tables and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from segloc.errors import SeglocError

from .harness import Row


def table_rows(row: Row) -> list[tuple[str, str, str]]:
    """(what, ms, how many times ours) of ours, of every rival and of the bound."""
    threads = f"{row.threads} thread{'s' if row.threads > 1 else ''}"
    rows = [(f"{row.name}, {threads}", _ms(row.ours_ms), "1.0")]
    rows += [(f"  {name}", _ms(ms), ratio) for name, ms, ratio in rivals_of(row)]
    if row.bound_ms is not None:
        rows.append((f"  bound: {row.bound}", _ms(row.bound_ms), _ratio(row.bound_ms, row.ours_ms)))
    return rows


def rivals_of(row: Row) -> list[tuple[str, float, str]]:
    """(name, ms, how many times ours) of every rival, the fastest first."""
    ordered = sorted(row.rivals.items(), key=lambda item: item[1])
    return [(name, ms, _ratio(ms, row.ours_ms)) for name, ms in ordered]


def rounded(value: float) -> float:
    """Three digits are as many as two runs share."""
    return float(f"{value:.3g}")


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _ratio(theirs: float, ours: float) -> str:
    return f"{theirs / ours:.1f}" if theirs > ours else f"{theirs / ours:.2f}"


def show(rows: Sequence[Row]) -> None:
    """Print rows as lines of text."""
    for row in rows:
        for what, ms, ratio in table_rows(row):
            print(f"{what:<60} {ms:>9} ms {ratio:>8}")
        print("".join(f"    {name}: {value:.5g}\n" for name, value in row.details.items()), end="")
        if row.skipped:
            print(f"    not installed: {', '.join(row.skipped)}")


def write_json(path: Path, rows: Iterable[Row]) -> None:
    """Write the rows as a JSON list.

    Raises
    ------
    SeglocError
        If the file cannot be written.
    """
    try:
        path.write_text(json.dumps([row.as_json() for row in rows], indent=1) + "\n", "utf-8")
    except OSError as error:
        raise SeglocError(f"{path}: cannot be written ({error.strerror or error})") from error
