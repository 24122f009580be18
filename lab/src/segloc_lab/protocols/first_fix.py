"""How far a robot drives from where it is switched on until it is localized, in offices and halls.

A part of each world is mapped in one session and driven through in another, with a tenth of the
things replaced. Robots are switched on at random places of that drive from which it keeps within
3 m of the mapped path for 5 m at least, and followed for 30 m; their odometry drifts by 1 %.

    python -m segloc_lab.protocols.first_fix --worlds 10 --trials 20
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from segloc import geometry

from ..report import Cell, Table, publish, share
from ..runner import Entry, Runner
from .kidnapping import Kind, world_of

KINDS = (
    Kind("offices", "os1-64", 80.0, 220.0, 0.5, "wheeled"),
    Kind("warehouse", "vlp16", 80.0, 220.0, 0.5, "wheeled"),
    Kind("offices", "vlp16", 80.0, 220.0, 0.5, "wheeled"),
    Kind("warehouse", "os1-64", 80.0, 220.0, 0.5, "wheeled"),
)
"""Used in turn."""
FOLLOWED_M, COVERED_M, SOON_M = 30.0, 5.0, 15.0


def switched_on(task: tuple[int, int]) -> Entry | None:
    """Switch a robot on, and follow it; None if the drive does not meet the map."""
    seed, number = task
    world = world_of(KINDS, seed)
    rng = np.random.default_rng([seed, number])
    drive = world.from_anywhere(FOLLOWED_M, COVERED_M, rng)
    if drive is None:
        return None
    found, spacing = world.followed(drive), world.kind.spacing_m
    path = geometry.distance_travelled(world.truths_of(drive))
    return {
        "seed": seed,
        "number": number,
        "scene": world.kind.scene,
        "sensor": world.kind.sensor,
        "first_fix_m": round(float(path[found.right.argmax()]), 2) if found.right.any() else None,
        "false_m": spacing * int(found.false.sum()),
    }


def row(scene: str, sensor: str, robots: list[Entry]) -> dict[str, Cell]:
    """Return the row of some robots."""
    fixes = [np.inf if r["first_fix_m"] is None else r["first_fix_m"] for r in robots]
    spread = np.percentile(fixes, (50, 95), method="higher")
    median, most = ("never" if np.isinf(metres) else f"{metres:.1f}" for metres in spread)
    return {
        "world": scene,
        "sensor": sensor,
        "robots": len(robots),
        "at once": share(sum(fix == 0.0 for fix in fixes), len(robots)),
        f"within {SOON_M:g} m": share(sum(fix <= SOON_M for fix in fixes), len(robots)),
        "never": sum(fix == np.inf for fix in fixes),
        "median (m)": median,
        "95 % (m)": most,
        "false for (m)": f"{sum(r['false_m'] for r in robots):g}",
    }


def report(robots: list[Entry], folder: Path | None) -> None:
    """Publish a row for each kind of world and sensor, and one of all."""
    names = sorted({(r["scene"], r["sensor"]) for r in robots})
    rows = [row(*n, [r for r in robots if (r["scene"], r["sensor"]) == n]) for n in names]
    note = f"Metres to the first right fix. Never: not within {FOLLOWED_M:g} m, or to the end."
    every = [row("all", "all", robots)] if robots else []
    publish(folder, "First fix after switching on", Table.of([*rows, *every], note))


def main() -> None:
    runner = Runner(__doc__, "first-fix.jsonl", first_seed=73000, worlds=10, choosing=("trials",))
    runner.options.add_argument("--trials", type=int, default=20, help="in each world")
    args = runner.parse()
    tasks = itertools.product(runner.seeds, range(args.trials))
    report(runner.run(switched_on, tasks, ("seed", "number")), args.report)


if __name__ == "__main__":
    main()
