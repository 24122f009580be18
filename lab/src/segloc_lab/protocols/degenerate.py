r"""Views that fix no place: a wall, a wall and its floor, a piece of corridor, a corner, a floor.

They are made (:mod:`..simulation.bare_views`), and lie in no map: each that is localized is false.

    python -m segloc_lab.protocols.degenerate MAPS/*.segmap --each 200 --report reports/degenerate
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Any

from segloc import Config, Localizer, Scan, SegmentMap

from ..report import Cell, Table, publish, wilson
from ..runner import Runner
from ..simulation.bare_views import VIEWS, view


def answers_in(path: Path, each: int) -> dict[str, Any]:
    """Localize the views in a map."""
    localizer = Localizer(SegmentMap.load(path), Config(threads=1))
    answers = []
    for name in VIEWS:
        for seed in range(each):
            start = time.process_time()
            found = localizer.localize(Scan(view(name, seed)))
            ms = round(1000 * (time.process_time() - start), 1)
            reason = found.reason and found.reason.name
            answers.append(
                {"view": name, "seed": seed, "reason": reason, "ms": ms}
                | {"confidence": found.confidence}
            )
    return {"map": name_of(path), "answers": answers}


def name_of(path: Path) -> str:
    """Return the name of a map; that of a generated world is its folder's."""
    return path.stem if path.stem != "own" else path.parent.name


def table(found: list[dict[str, Any]]) -> Table:
    """Count the views that were localized, by kind and map."""
    rows: list[tuple[Cell, ...]] = []
    flat = [{**a, "map": each["map"]} for each in found for a in each["answers"]]
    for by in ("view", "map"):
        for value in dict.fromkeys(a[by] for a in flat):
            here = [a for a in flat if a[by] == value]
            false = [a for a in here if a["reason"] is None]
            most = max(a["confidence"] for a in here)
            rows.append((value, len(here), len(false), f"{most:.4f}"))
    count = sum(a["reason"] is None for a in flat)
    rows.append(("all", len(flat), count, f"{max(a['confidence'] for a in flat):.4f}"))
    note = f"At most {100 * wilson(count, len(flat))[1]:.3f} % by Wilson's 95 % interval."
    return Table(("view or map", "views", "localized", "largest confidence"), rows, note)


def main() -> None:
    runner = Runner(__doc__, "degenerate.jsonl", parallel=True, choosing=("maps",))
    add = runner.options.add_argument
    add("maps", type=Path, nargs="*")
    add("--each", type=int, default=200, help="views of each kind in each map")
    args = runner.parse()
    work = partial(answers_in, each=args.each)
    found = runner.run(work, args.maps, ("map",), lambda path: [name_of(path)])
    publish(args.report, "Views that fix no place", table(found))


if __name__ == "__main__":
    main()
