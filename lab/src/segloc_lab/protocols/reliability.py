"""How often the best pose of a query is right, by the confidence that the verdict has in it.

    python -m segloc_lab.protocols.reliability --real real.json --simulated queries.json

The files are what ``protocols.real`` and ``protocols.simulation_queries`` keep (``--out``). Every
query counts that has any pose, localized or refused, in maps that hold it and in maps that do not;
more than a high confidence is asked of most before they are believed. Nothing that is counted here
took part in the fit of the confidence.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration.reliability import BINS
from ..evaluation.intervals import share
from ..report import Cell, Table, publish
from ..script import reporting

Judged = list[tuple[float, bool]]
"""The confidence in a pose, and whether it is right."""


def judged(answers: Iterable[dict[str, Any]]) -> Judged:
    """Of the answers that have a pose."""
    return [(a["confidence"], a["best"] == "found") for a in answers if a["best"]]


def table(sets: dict[str, Judged]) -> list[tuple[Cell, ...]]:
    """A row for each bin of the confidence, and one with the Brier score of each set."""
    rows: list[tuple[Cell, ...]] = []
    for low, high in pairwise(BINS):
        inside = [[right for p, right in pairs if low <= p < high] for pairs in sets.values()]
        shares = (share(sum(right), len(right)) for right in inside)
        rows.append((f"{low:.2f} to {min(high, 1.0):.2f}", *shares))
    return [*rows, ("Brier score", *(_brier(pairs) for pairs in sets.values()))]


def _brier(pairs: Judged) -> Cell:
    if not pairs:
        return None
    p, right = np.array(pairs, dtype=np.float64).T
    return round(float(((p - right) ** 2).mean()), 4)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--real", type=Path, required=True)
    options.add_argument("--simulated", type=Path, required=True)
    args = options.parse_args()
    simulated = json.loads(args.simulated.read_text()).values()
    sets = {
        "real: right": judged(json.loads(args.real.read_text())),
        "simulated: right": judged(answer for rows in simulated for answer in rows),
    }
    columns, rows = ("confidence", *sets), table(sets)
    note = "Of all queries that have a pose, believed or not; in brackets 95 % by Wilson."
    publish(args.report, "Reliability of the confidence", Table(columns, rows, note))


if __name__ == "__main__":
    main()
