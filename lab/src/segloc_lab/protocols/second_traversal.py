"""Store what ``segloc demo`` shows as a table: a town driven again, and another town.

python -m segloc_lab.protocols.second_traversal --store docs/results
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from segloc.cli.demo import demo

from ..evaluation.intervals import share
from ..results.store import Cell, Result
from ..script import storing

COLUMNS = ("", "another day", "another town")
COMMAND = "python -m segloc_lab.protocols.second_traversal --store docs/results"


def summaries() -> list[dict[str, Any]]:
    """Run the demo; return the summaries of both drives."""
    with TemporaryDirectory() as folder:
        demo(Path(folder))
        return [
            json.loads((Path(folder) / drive / "summary.json").read_text("utf-8"))
            for drive in ("revisit", "elsewhere")
        ]


def rows(found: list[dict[str, Any]]) -> list[tuple[Cell, ...]]:
    """Counts of both, and the error."""

    def error(summary: dict[str, Any]) -> str:
        median = summary["translation_error_m"]["median"]
        return "-" if median is None else f"{median:.2f} m"

    return [
        ("queries", *(s["queries"] for s in found)),
        (
            "found within map coverage",
            *(share(s["within_coverage_correct"], s["within_coverage"]) for s in found),
        ),
        (
            "near the map, correct too",
            *(s["correct"] - s["within_coverage_correct"] for s in found),
        ),
        ("false", *(s["false"] for s in found)),
        ("error, median", *map(error, found)),
    ]


def main() -> None:
    args = storing(__doc__).parse_args()
    table = rows(summaries())
    note = "`profile`; in brackets 95 % by Wilson."
    Result.measured("demo", COMMAND, COLUMNS, table, methods=("profile",), note=note).tell(
        args.store
    )


if __name__ == "__main__":
    main()
