"""Markdown rows from the results of ``segloc localize``.

python -m segloc_experiments.protocols.table out/accumulated-geo out/single-geo
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..script import head, parser, row

COLUMNS = (
    "run",
    "queries",
    "found within coverage",
    "false",
    "error m, median / 95 %",
    "deg",
    "ms",
)


def run_row(folder: Path) -> str:
    """One run as a row of the table."""
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    metres, degrees = summary["translation_error_m"], summary["rotation_error_deg"]
    return row(
        folder.name,
        summary["queries"],
        f"{summary['within_coverage_correct']} of {summary['within_coverage']}",
        summary["false"],
        _spread(metres),
        _spread(degrees),
        f"{summary['ms']['total']:.0f}",
    )


def _spread(values: dict[str, float | None]) -> str:
    if values["median"] is None:
        return "-"
    return f"{values['median']:.2f} / {values['p95']:.2f}"


def main() -> None:
    options = parser(__doc__)
    options.add_argument("runs", nargs="+", type=Path)
    args = options.parse_args()
    print(head(*COLUMNS))
    for folder in args.runs:
        print(run_row(folder))


if __name__ == "__main__":
    main()
