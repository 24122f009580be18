"""Markdown rows from the results of ``segloc localize``, and the table as it is stored.

    python -m segloc_lab.protocols.table out/*-geo --store docs/results

What is stored are the runs that ``kitti00.sh`` left, which says with each what code it is of.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..evaluation.intervals import share
from ..evaluation.methods import METHODS
from ..results.stamp import stamped
from ..results.store import Origin, Result
from ..script import head, row, storing

COLUMNS = ("run", "queries", "found within map coverage", "false", "error m, median / 95 %", "deg")
COMMANDS = """\
lab/src/segloc_lab/protocols/kitti00.sh DATA out {methods}
    python -m segloc_lab.protocols.table out/*-*/ --store docs/results"""
PROTOCOLS = ("accumulated", "single", "sparse")


def cells(folder: Path) -> tuple[str | int, ...]:
    """One run as a row of the table."""
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


def result(runs: Sequence[Path]) -> Result:
    """The runs of ``kitti00.sh`` as one table, in the order of protocols and methods.

    Raises
    ------
    DatasetError
        If they are not all of the same code, or one does not say of which.
    """
    ordered = sorted(runs, key=_place)
    methods = [m for m in METHODS if any(_parts(run)[1] == m for run in runs)]
    origin = Origin.of_all({run.name: stamped(run) for run in ordered})
    note = "In brackets: 95 % by Wilson."
    command = COMMANDS.format(methods=" ".join(methods))
    return Result.of(
        origin, "kitti00", command, COLUMNS, [cells(run) for run in ordered], note=note
    )


def _parts(run: Path) -> tuple[str, str]:
    protocol, _, method = run.name.partition("-")
    return protocol, method


def _place(run: Path) -> tuple[int, int]:
    protocol, method = _parts(run)
    return PROTOCOLS.index(protocol), METHODS[::-1].index(method)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("runs", nargs="+", type=Path)
    args = options.parse_args()
    print(head(*COLUMNS))
    for folder in args.runs:
        print(row(*cells(folder)))
    if args.store:
        print(result(args.runs).save(args.store))


if __name__ == "__main__":
    main()
