"""What :mod:`.real` found, as a table, and as it is stored."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import numpy as np

from ..evaluation.intervals import share, wilson
from ..results.store import Result
from ..script import show

COLUMNS = (
    "queries",
    "found within map coverage",
    "false",
    "elsewhere",
    "false elsewhere",
    "ms",
)


def rows(records: list[dict[str, Any]]) -> list[tuple[str | int, ...]]:
    """A row for each set of queries."""
    found: list[tuple[str | int, ...]] = []
    for name in dict.fromkeys(r["queries"] for r in records):
        here = [r for r in records if r["queries"] == name]
        near = [r for r in here if r["within_coverage"]]
        far = [r for r in here if not r["within_coverage"]]
        right = sum(r["outcome"] == "found" for r in near)
        wrong = [sum(r["outcome"] == "false" for r in part) for part in (near, far)]
        ms = float(np.median([r["ms"] for r in near or far]))
        cell = share(right, len(near)) if near else "-"
        found.append((name, cell, wrong[0], len(far), wrong[1], f"{ms:.0f}"))
    return found


def report(records: list[dict[str, Any]]) -> None:
    """The table, and what is false."""
    show(COLUMNS, rows(records))
    for r in records:
        if r["outcome"] == "false":
            print(json.dumps(r))


def result(records: list[dict[str, Any]], method: str, step: int) -> Result:
    """The table as it is stored."""
    elsewhere = [r for r in records if not r["within_coverage"]]
    false = [r for r in records if r["outcome"] == "false"]
    _, most = wilson(sum(r in false for r in elsewhere), len(elsewhere))
    note = (
        f"`{method}`; of KITTI every {step}. query; in brackets 95 % by Wilson. Elsewhere: in the "
        "maps of all other places, in the mirror image of the own one, and beyond its path "
        f"({len(elsewhere)} queries: at most {100 * most:.2g} % are false). Milliseconds of "
        "processor time of one thread, on a machine with much other work."
    )
    reasons = Counter(r["reason"] for r in records if r["within_coverage"] and r["reason"])
    command = f"python -m segloc_lab.protocols.real DATA --step {step} --store docs/results"
    counts = {"false": false, "reasons within coverage": dict(reasons)}
    return Result.measured(
        "real", command, COLUMNS, rows(records), methods=(method,), note=note, counts=counts
    )
