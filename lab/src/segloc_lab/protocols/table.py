"""Table of the runs of ``kitti00.sh``.

python -m segloc_lab.protocols.table OUT/*-*/ --report FOLDER
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..evaluation.comparison import METHODS
from ..report import Table, publish, reporting, share

COLUMNS = ("run", "queries", "found within map coverage", "false", "error m, median / 95 %", "deg")
PROTOCOLS = ("accumulated", "single", "sparse")


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
    rows = [cells(run) for run in sorted(args.runs, key=_place)]
    publish(args.report, "KITTI 00", Table(COLUMNS, rows, "In brackets: 95 % by Wilson."))


if __name__ == "__main__":
    main()
