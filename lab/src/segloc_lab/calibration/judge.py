"""Localize the queries of sealed worlds end to end, and count what is found, false and refused.

The worlds (:data:`.worlds.SEALED`) take no part in the fit. Answers are kept, one line a world, so
that a run continues where it stopped; files of other versions stand beside it in the table.

    python -m segloc_lab.calibration.judge rows/sealed --out posterior.jsonl --beside 0.2.0.jsonl
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer

from ..report import Cell, Table, entries, publish, wilson
from ..runner import Runner
from .rows import BARE, HOME, World, errors, is_right, worlds_of

Answers = list[dict[str, Any]]
WHOLE = ("single", "thinned", "accumulated")
"""Queries of whole views: narrow and made ones are counted apart."""


def answers_in(world: World, config: Config) -> dict[str, Any]:
    """Localize every query of a world in its maps."""
    places = {name: Localizer(prior_map, config) for name, prior_map in world.maps.items()}
    answers = []
    for n, made in enumerate(world.queries()):
        for name in world.searched(n, made):
            start = time.process_time()
            answer = places[name].localize(made.scans)
            taken = time.process_time() - start
            metres = degrees = None
            truth = made.truth if name in HOME else None
            if answer.T_map_sensor is not None and truth is not None:
                metres, degrees = (round(e, 3) for e in errors(answer.T_map_sensor, truth))
            answers.append(
                {
                    "query": n,
                    "made": made.kind,
                    "sensor": made.sensor,
                    "map": name if made.truth is not None else BARE,
                    "localized": answer.localized,
                    "error_m": metres,
                    "error_deg": degrees,
                    "confidence": answer.confidence,
                    "reason": answer.reason and answer.reason.name,
                    "ms": round(1000 * taken, 1),
                }
            )
    return {"world": world.name, "kind": world.kind, "answers": answers}


def flat(worlds: Sequence[dict[str, Any]]) -> Answers:
    """List the answers of all worlds with their outcome."""
    named = ({**a, "world": w["world"], "kind": w["kind"]} for w in worlds for a in w["answers"])
    return [{**a, "outcome": outcome(a)} for a in named]


def outcome(answer: dict[str, Any]) -> str:
    """Classify an answer as found, false or refused."""
    if not answer["localized"]:
        return "refused"
    if answer["error_m"] is None:
        return "false"
    return "found" if is_right(answer["error_m"], answer["error_deg"]) else "false"


COLUMNS = ("queries", "answers of", "in their map", "found", "elsewhere", "false", "worlds")


def table(runs: dict[str, Answers], by: str, title: str) -> Table:
    """Count outcomes by a property of the queries, one row for each run."""
    values = dict.fromkeys(str(a[by]) for answers in runs.values() for a in answers)
    rows = [
        _counted(value, name, [a for a in answers if a[by] == value])
        for value in values
        for name, answers in runs.items()
    ]
    return Table(COLUMNS, rows, title=title)


def _counted(value: str, name: str, answers: Answers) -> tuple[Cell, ...]:
    home = [a["outcome"] for a in answers if a["map"] in HOME]
    false = [a for a in answers if a["outcome"] == "false"]
    spoilt = len({a["world"] for a in false})
    found = home.count("found")
    return (value, name, len(home), found, len(answers) - len(home), len(false), spoilt)


def summary(runs: dict[str, Answers]) -> Table:
    """Compare runs as a whole: found, false with bounds by query and by world, time."""
    columns = (
        "answers of",
        "found",
        "false",
        "at most, queries",
        "worlds",
        "at most",
        "ms",
        "95 %",
    )
    rows = [(name, *_summed(answers)) for name, answers in runs.items()]
    note = "At most: upper ends of Wilson's 95 % intervals. Times are of one core."
    return Table(columns, rows, note, "All")


def _summed(answers: Answers) -> Iterator[Cell]:
    home = [a for a in answers if a["map"] in HOME]
    false = [a for a in answers if a["outcome"] == "false"]
    worlds, spoilt = ({a["world"] for a in chosen} for chosen in (answers, false))
    yield f"{sum(a['outcome'] == 'found' for a in home)} of {len(home)}"
    yield f"{len(false)} of {len(answers)}"
    yield f"{100 * wilson(len(false), len(answers))[1]:.2f} %"
    yield f"{len(spoilt)} of {len(worlds)}"
    yield f"{100 * wilson(len(spoilt), len(worlds))[1]:.0f} %"
    yield from (round(float(np.percentile([a["ms"] for a in answers], q))) for q in (50, 95))


def main() -> None:
    runner = Runner(
        __doc__,
        "posterior.jsonl",
        parallel=True,
        choosing=("beside", "quiet", "every", "first"),
    )
    add = runner.options.add_argument
    add("worlds", type=Path, help="folder of generated worlds")
    add("--beside", type=Path, nargs="+", default=[], help="answers of others")
    add("--quiet", action="store_true", help="keep the answers, show no table")
    add("--every", type=int, default=1, help="take each Nth world")
    add("--first", type=int, default=0, help="number of the first world taken")
    args = runner.parse()
    work = partial(answers_in, config=Config(threads=1))
    chosen = worlds_of(args.worlds)[args.first :: args.every]
    own = runner.run(work, chosen, ("world",), lambda world: [world.name])
    if not args.quiet:
        every = {args.out.stem: flat(own)}
        every |= {path.stem: flat(entries(path)) for path in args.beside}
        whole = {name: [a for a in run if a["made"] in WHOLE] for name, run in every.items()}
        by = (("kind", "By kind"), ("map", "By map"))
        publish(
            args.report,
            "Answers in sealed worlds",
            summary(whole),
            *(table(whole, name, title) for name, title in by),
            table(every, "made", "By query, narrow and made views too"),
        )


if __name__ == "__main__":
    main()
