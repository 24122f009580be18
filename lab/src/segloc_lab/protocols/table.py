"""Table of the runs of ``kitti00.sh``.

python -m segloc_lab.protocols.table OUT/*-*/ --report FOLDER
"""

from __future__ import annotations

import json
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any

from ..evaluation.comparison import METHODS
from ..report import Table, entries, publish, reporting, share

COLUMNS = ("run", "queries", "found within map coverage", "false", "error m, median / 95 %", "deg")
PROTOCOLS = ("accumulated", "single", "sparse")
BEYOND_M = (0, 3, 10, 20, 30, 40, inf)
"""Bins of the distance of a query from the mapped trajectory [m]."""
BINS = [
    f"beyond {low} m" if high == inf else f"{low} to {high} m" for low, high in pairwise(BEYOND_M)
]


def cells(folder: Path) -> tuple[str | int, ...]:
    """Return one run as a row of the table."""
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return (
        folder.name,
        summary["queries"],
        share(summary["within_coverage_correct"], summary["within_coverage"]),
        summary["false"],
        _spread(summary["translation_error_m"]),
        _spread(summary["rotation_error_deg"]),
    )


def by_distance(folder: Path) -> tuple[str, ...]:
    """Return the queries of a run that are found, by their distance from the map's trajectory."""
    queries = [
        (q["distance_to_map_m"], q["correct"]) for q in entries(folder / "localizations.jsonl")
    ]
    row = [folder.name]
    for low, high in pairwise(BEYOND_M):
        found = [correct for metres, correct in queries if low <= metres < high]
        row.append(f"{sum(found)} of {len(found)}")
    return tuple(row)


def _spread(values: dict[str, float | None]) -> str:
    if values["median"] is None:
        return "-"
    return f"{values['median']:.2f} / {values['p95']:.2f}"


def _place(run: Path) -> tuple[int, int]:
    protocol, _, method = run.name.partition("-")
    return PROTOCOLS.index(protocol), METHODS[::-1].index(method)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("runs", nargs="+", type=Path)
    args = options.parse_args()
    runs = sorted(args.runs, key=_place)
    publish(
        args.report,
        "KITTI 00",
        Table(COLUMNS, [cells(run) for run in runs], "In brackets: 95 % by Wilson."),
        Table(
            ("run", *BINS),
            [by_distance(run) for run in runs],
            title="Found, by the distance from the mapped trajectory",
        ),
    )


if __name__ == "__main__":
    main()
