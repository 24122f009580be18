"""What ``segloc demo`` shows, as a table that is kept: a town driven again, and another town.

python -m segloc_experiments.protocols.second_traversal --store docs/results
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from segloc.batch.intervals import share
from segloc.cli.demo import demo

from ..results.store import Cell, Result
from ..script import storing

COLUMNS = ("", "second traversal", "another town")
COMMAND = "python -m segloc_experiments.protocols.second_traversal --store docs/results"


def summaries(seed: int) -> list[dict[str, Any]]:
    """The summaries of both drives through a town."""
    with TemporaryDirectory() as folder:
        demo(Path(folder), seed)
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
    options = storing(__doc__)
    options.add_argument("--seed", type=int, default=0, help="another is another town")
    args = options.parse_args()
    table = rows(summaries(args.seed))
    note = f"`profile`, town {args.seed}; in brackets 95 % by Wilson."
    Result.measured("demo", COMMAND, COLUMNS, table, methods=("profile",), note=note).tell(
        args.store
    )


if __name__ == "__main__":
    main()
