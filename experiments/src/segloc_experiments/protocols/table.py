"""Markdown rows from the results of ``segloc localize``.

python benchmarks/table.py out/accumulated-geo out/single-geo
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

HEAD = (
    "| run | queries | found at a place | false | error m, median / 95 % | deg | ms |\n"
    "|---|---|---|---|---|---|---|"
)


def row(folder: Path) -> str:
    """One run as a row of the table."""
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    metres, degrees = summary["translation_error_m"], summary["rotation_error_deg"]
    cells = [
        folder.name,
        summary["queries"],
        f"{summary['within_coverage_correct']} of {summary['within_coverage']}",
        summary["false"],
        _spread(metres),
        _spread(degrees),
        f"{summary['ms']['total']:.0f}",
    ]
    return "| " + " | ".join(map(str, cells)) + " |"


def _spread(values: dict[str, float | None]) -> str:
    if values["median"] is None:
        return "-"
    return f"{values['median']:.2f} / {values['p95']:.2f}"


if __name__ == "__main__":
    print(HEAD)
    for argument in sys.argv[1:]:
        print(row(Path(argument)))
