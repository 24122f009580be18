"""Robots that are carried away while their odometry notices nothing: how soon is that noticed?

    python -m segloc_lab.protocols.kidnapping --worlds 48 --out kidnapping.jsonl

A part of each world is mapped in one session and driven through in another, with other cars and a
tenth of the things replaced. Each robot drives 40 m along the map. Then it is put to another street
(20 m away at least), to a place that is not in the map, or turned on the spot, and drives on for
100 m, as far as the drive goes. Its odometry drifts by 1 % and goes on as if nothing had happened.
Noticed: no longer localized. Recovered: localized within 2 m and 10 degrees of the truth, where the
map has the place. Held: metres of the whole trial localized farther off than that.

Each seed is a world of its own, so runs of different seeds can work at once. What was tried is
kept, a line a trial, and a run goes on where the last one ended. ``--add`` adds up. Needs the
extra ``sim``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..evaluation.intervals import share
from ..report import Cell, Table, publish
from ..script import entries, keep, resumed
from .kidnapped import HELD_M, KINDS, NOTICED_M, RECOVERED_M, WAYS, Trial, World

COLUMNS = (
    "world",
    "sensor",
    "carried to",
    "trials",
    "known before",
    f"noticed within {NOTICED_M:g} m",
    f"recovered within {RECOVERED_M:g} m",
    f"false for more than {HELD_M:g} m",
    "noticed, median / worst (m)",
    "recovered, median / worst (m)",
    "held, worst (m)",
)


def table(found: list[Trial]) -> list[tuple[Cell, ...]]:
    """A row for each kind of world, one for each way, and one of all."""
    rows = []
    for kind in KINDS:
        here = [t for t in found if (t.scene, t.sensor) == (kind.scene, kind.sensor)]
        rows.append(_row((kind.scene, kind.sensor, "all"), here))
    rows += [_row(("all", "all", way), [t for t in found if t.way == way]) for way in WAYS]
    return [*rows, _row(("all", "all", "all"), found)]


def _row(name: tuple[str, str, str], found: list[Trial]) -> tuple[Cell, ...]:
    known = [t for t in found if t.known]
    mapped = [t for t in known if t.way != "outside"]
    noticed = [np.inf if t.noticed is None else t.noticed for t in known]
    recovered = [np.inf if t.recovered is None else t.recovered for t in mapped]
    held = [t.held for t in found]
    return (
        *name,
        len(found),
        len(known),
        share(int((np.array(noticed) <= NOTICED_M).sum()), len(known)),
        share(int((np.array(recovered) <= RECOVERED_M).sum()), len(mapped)),
        int((np.array(held) > HELD_M).sum()),
        _spread(noticed),
        _spread(recovered),
        max(held, default=0.0),
    )


def _spread(values: list[float]) -> str:
    if not values:
        return "-"
    worst = "never" if np.isinf(values).any() else f"{max(values):.0f}"
    return f"{np.median(values):.0f} / {worst}"


def report(found: list[Trial], folder: Path | None) -> None:
    """Publish the table."""
    note = "Recovered: of those known before and put where the map has the place."
    publish(folder, "Robots that are carried away", Table(COLUMNS, table(found), note))


def read(paths: Iterable[Path]) -> list[Trial]:
    """The trials of earlier runs, each once."""
    kept = [entry for path in paths if path.exists() for entry in entries(path)]
    found = {(t.seed, t.number): t for t in (Trial(**entry) for entry in kept)}
    return [found[key] for key in sorted(found)]


def main() -> None:
    options = resumed(__doc__, "kidnapping.jsonl")
    options.add_argument("--worlds", type=int, default=48)
    options.add_argument("--trials", type=int, default=5, help="in each world")
    options.add_argument("--first-seed", type=int, default=4104)
    options.add_argument("--seconds", type=float, default=np.inf, help="begin nothing after these")
    options.add_argument("--done", type=Path, nargs="+", default=[], help="what others have tried")
    args = options.parse_args()
    if args.add:
        report(read(args.add), args.report)
        return
    begun = time.monotonic()
    done = {(t.seed, t.number) for t in read([args.out, *args.done])}
    for seed in range(args.first_seed, args.first_seed + args.worlds):
        world = None
        for number in range(args.trials):
            if (seed, number) in done or time.monotonic() - begun > args.seconds:
                continue
            world = world or World(KINDS[seed % len(KINDS)], seed)
            if len(world.known):  # a drive need not meet the map
                keep(args.out, asdict(world.trial(number)))
    report(read([args.out]), args.report)


if __name__ == "__main__":
    main()
