"""Compare the reported probability with that of the thorough search, to which the model was fitted.

Each query of generated worlds is searched as a localizer does, and thoroughly: all proposers are
asked, and the most promising places are measured to the end.

    python -m segloc_lab.protocols.one_number WORLDS --every 3 --report reports/one-number
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from segloc import Config, Localizer
from segloc.likelihood import log_odds, shipped_model
from segloc.localization import Reason

from ..calibration.rows import World, run_in_worlds
from ..report import Table, publish

COLUMNS = ("kind", "searches", "accepted", "thorough", "compared", "median", "95 %", "not in map")
NOT_IN_MAP = 0.9
"""Probability from which "not in this map" is said."""


def compared_in(world: World, config: Config) -> dict[str, Any]:
    """Search every query of a world in its maps, both ways."""
    places = {name: Localizer(prior_map, config) for name, prior_map in world.maps.items()}
    found = []
    for n, made in enumerate(world.queries()):
        query = places["own"].describe(made.scans)
        for name in world.searched(n, made):
            one, full = (places[name].search(query, thorough=way) for way in (False, True))
            found.append(
                {
                    "map": name,
                    "made": made.kind,
                    "reported": one.posterior.confidence,
                    "thorough": full.posterior.confidence,
                    "not_in_map": one.posterior.not_in_map,
                    "reason": one.reason and one.reason.name,
                    "accepted": full.reason is None,
                }
            )
    return {"world": world.name, "kind": world.kind, "found": found}


def table(worlds: list[dict[str, Any]], cap: float) -> Table:
    """Compare log-odds where one of both is above 0 and both are below the cap."""
    rows = []
    for kind in (*dict.fromkeys(w["kind"] for w in worlds), "all"):
        found = [a for w in worlds if kind in (w["kind"], "all") for a in w["found"]]
        pairs = np.array([[log_odds(a[k]) for k in ("reported", "thorough")] for a in found])
        near = (pairs < cap).all(axis=1) & (pairs > 0.0).any(axis=1)
        apart = np.abs(pairs[near, 0] - pairs[near, 1])
        lost = sum(
            a["accepted"]
            and a["reason"] == Reason.NOT_IN_MAP.name
            and a["not_in_map"] >= NOT_IN_MAP
            for a in found
        )
        middle, most = np.percentile(apart, (50, 95)) if len(apart) else (0.0, 0.0)
        counts = sum(a["reason"] is None for a in found), sum(a["accepted"] for a in found)
        rows.append((kind, len(found), *counts, len(apart), f"{middle:.2f}", f"{most:.2f}", lost))
    note = (
        "Median and 95 %: differences of log-odds where both are below the cap and one is above 0. "
        f"Not in map: refused as such with a probability of {NOT_IN_MAP:g} or more, though the "
        "thorough search accepts a pose."
    )
    return Table(COLUMNS, rows, note)


def main() -> None:
    work = partial(compared_in, config=Config(threads=1))
    args, found = run_in_worlds(__doc__, "one-number.jsonl", work)
    cap = log_odds(1.0 - shipped_model().lapse) - 0.01  # rounding
    publish(args.report, "Reported and thorough", table(found, cap))


if __name__ == "__main__":
    main()
