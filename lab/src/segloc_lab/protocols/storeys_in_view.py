"""Five storeys: what is found where the floors differ in what a query sees, and where they do not.

From a corridor the storeys of one building may look the same. So each query of the scenarios of
five storeys is cast once more, from the same place on every storey, as the sensor would have seen
it on the day of the map. A point of the query differs on a storey that has nothing within 0.3 m of
it then. The storeys differ in view by the share of points that differ on the most similar other
one, less the share that has changed on the query's own. Nothing of that is known to segloc.

    python -m segloc_lab.protocols.storeys_in_view --work WORK --store docs/results
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy.spatial import cKDTree

from segloc.types import Float64

from ..evaluation.intervals import share
from ..recordings import kept
from ..results.store import Result
from ..script import storing
from ..simulation import Conditions, SimulatedSequence
from .equal_storeys import cloud
from .simulation_queries import HEIGHT_M, SCANS, cloud_of, errors, is_right, localizer_of
from .simulation_scenarios import Scenario, scenarios, storey_of

WITHIN_M = 0.3
BOUNDS = (0.01, 0.03)
"""Shares of points between which the lines of the table lie."""
COLUMNS = ("points that differ", "queries", "found", "wrong floor", "false on the floor", "refused")


def when_mapped(drive: SimulatedSequence, up_m: float) -> Float64:
    """The points that the query would have had higher up, on the day of the map; lowered again."""
    truth = drive.truth.copy()
    truth[:, 2, 3] += up_m
    there = replace(drive, session=0, conditions=Conditions(), truth=truth, poses=truth, _last=None)
    return cloud(there) - [0.0, 0.0, up_m]


def differs(drive: SimulatedSequence, work: Path | None = None) -> float:
    """By what share of its points a query tells its storey from the most similar other one."""
    assert drive.world.interior is not None
    floors = np.array(drive.world.interior.storeys)
    own, points = storey_of(drive.world, drive.truth[-1]), cloud(kept(drive, work))
    off = []
    for z in floors - floors[own]:
        gaps = cKDTree(when_mapped(drive, float(z))).query(points, distance_upper_bound=WITHIN_M)[0]
        off.append(float(np.isinf(gaps).mean()))
    return min(v for k, v in enumerate(off) if k != own) - off[own]


def answers(scenario: Scenario, work: Path, count: int) -> Iterator[tuple[float, str]]:
    """Of each query by how much the storeys differ in view, and a word for its answer."""
    for seed in scenario.seeds:
        localizer = localizer_of(scenario, seed, work)
        for drive, _ in track(scenario.queries(seed, count), f"{scenario.map_name}, {seed}"):
            T = localizer.localize(cloud_of(drive, work)).T_map_sensor
            differ = differs(drive, work / SCANS)
            yield differ, "refused" if T is None else outcome(T, drive.truth[-1])


def outcome(T: Float64, truth: Float64) -> str:
    """Whether a pose is right, or on which floor it is wrong."""
    if is_right(T, truth):
        return "found"
    return "wrong floor" if abs(errors(T, truth)[2]) > HEIGHT_M else "false on the floor"


def rows(found: list[tuple[float, str]]) -> list[tuple[str | int, ...]]:
    """A line for each range of shares."""
    lines: list[tuple[str | int, ...]] = []
    edges = (-1.0, *BOUNDS, 2.0)
    names = (
        f"less than {BOUNDS[0]:.0%}",
        f"{BOUNDS[0]:.0%} to {BOUNDS[1]:.0%}",
        f"{BOUNDS[1]:.0%} and more",
    )
    for name, low, high in zip(names, edges[:-1], edges[1:], strict=True):
        words = Counter(word for value, word in found if low <= value < high)
        rest = (words[word] for word in COLUMNS[3:])
        lines.append((name, words.total(), share(words["found"], words.total()), *rest))
    return lines


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--work", type=Path, required=True, help="where maps and scans are kept")
    options.add_argument("--count", type=int, default=10, help="queries a seed")
    args = options.parse_args()
    found = [
        answer
        for name, scenario in scenarios().items()
        if name.startswith("five ")
        for answer in answers(scenario, args.work, args.count)
    ]
    command = "python -m segloc_lab.protocols.storeys_in_view --work WORK --store docs/results"
    note = (
        f"`profile`; of the points of a query, those with nothing within {WITHIN_M:g} m on the "
        "most similar other storey when that was mapped, less those that have changed on its own; "
        "in brackets 95 % by Wilson."
    )
    counts = {"answers": [f"{value:.4f} {word}" for value, word in found]}
    Result.measured(
        "storeys-in-view",
        command,
        COLUMNS,
        rows(found),
        methods=("profile",),
        note=note,
        counts=counts,
    ).tell(args.store)


if __name__ == "__main__":
    main()
