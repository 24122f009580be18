"""What is localized at first sight, beside the same queries by segments.

Each query of generated worlds is localized in its maps by a localizer that looks first, and by one
that matches segments at once. False is beyond 2 m or 5 degrees, or in the map of another place.

    python -m segloc_lab.protocols.first_sight WORLDS --every 3 --report reports/first-sight
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from segloc import Config, Localizer, geometry
from segloc.proposals import FirstSight

from ..calibration.rows import HOME, World, errors, is_right, run_in_worlds
from ..report import Table, publish

COLUMNS = (
    "kind",
    "searches",
    "found",
    "by segments",
    "at first sight",
    "of them false",
    "m apart, 95 %",
    "at first sight, ms",
    "by segments, ms",
    "found otherwise, ms",
    "by segments, ms",
    "refused, ms",
    "by segments, ms",
)
WAYS = ("seen", "matched")


def ways(config: Config) -> tuple[Config, Config]:
    """Return a configuration, and the same without first sight."""
    off = config.first_sight.model_copy(update={"enabled": False})
    return config, config.model_copy(update={"first_sight": off})


def compared_in(world: World, config: Config) -> dict[str, Any]:
    """Localize every query of a world in its maps, both ways."""
    places = {
        name: [Localizer(prior_map, way) for way in ways(config)]
        for name, prior_map in world.maps.items()
    }
    found = []
    for n, made in enumerate(world.queries()):
        for name in world.searched(n, made):
            truth = made.truth if name in HOME else None
            row: dict[str, Any] = {"map": name, "made": made.kind}
            poses = {}
            # In turns: the second way finds the scan in the processor's cache.
            for way, localizer in list(zip(WAYS, places[name], strict=True))[:: 1 - 2 * (n % 2)]:
                start = time.process_time()
                answer = localizer.localize(made.scans)
                row[f"{way}_ms"] = 1e3 * (time.process_time() - start)
                row[way] = outcome(answer.T_map_sensor, truth)
                poses[way] = answer.T_map_sensor
                if way == "seen":
                    row["first"] = answer.localized and answer.proposer == FirstSight.name
            one, other = (poses[way] for way in WAYS)
            if row["first"] and one is not None and other is not None:
                row["apart_m"] = float(np.linalg.norm((geometry.inverse(one) @ other)[:3, 3]))
            found.append(row)
    return {"world": world.name, "kind": world.kind, "found": found}


def outcome(T_map_sensor: np.ndarray | None, truth: np.ndarray | None) -> str:
    """Classify a pose as found, false or refused."""
    if T_map_sensor is None:
        return "refused"
    return "found" if truth is not None and is_right(*errors(T_map_sensor, truth)) else "false"


def table(worlds: list[dict[str, Any]]) -> Table:
    """Count by kind of world what is found both ways, and compare times of equal outcomes."""
    rows = []
    for kind in (*dict.fromkeys(w["kind"] for w in worlds), "all"):
        found = [a for w in worlds if kind in (w["kind"], "all") for a in w["found"]]
        first = [a for a in found if a["first"]]
        apart = [a["apart_m"] for a in first if "apart_m" in a]
        groups = (
            first,
            [a for a in found if not a["first"] and same(a, "found")],
            [a for a in found if same(a, "refused")],
        )
        rows.append(
            (
                kind,
                len(found),
                *(sum(a[way] == "found" for a in found) for way in WAYS),
                len(first),
                sum(a["seen"] == "false" for a in first),
                f"{np.percentile(apart, 95):.3f}" if apart else "-",
                *(median_ms(group, way) for group in groups for way in WAYS),
            )
        )
    note = (
        "Searches: each query in each of its maps. Apart: poses at first sight and those by "
        "segments. Milliseconds: median processor time of the same searches both ways."
    )
    return Table(COLUMNS, rows, note)


def median_ms(answers: list[dict[str, Any]], way: str) -> str:
    """Return the median processor time of answers by a way [ms]."""
    return f"{np.median([a[f'{way}_ms'] for a in answers]):.1f}" if answers else "-"


def same(answer: dict[str, Any], what: str) -> bool:
    """Return whether an answer has an outcome both ways."""
    return bool(answer["seen"] == answer["matched"] == what)


def main() -> None:
    work = partial(compared_in, config=Config(threads=1))
    args, found = run_in_worlds(__doc__, "first-sight.jsonl", work)
    publish(args.report, "At first sight", table(found))


if __name__ == "__main__":
    main()
