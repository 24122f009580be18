"""Loss of each method when trained on another domain (Table I of the paper)."""

from __future__ import annotations

import time
from collections.abc import Callable

from ...evaluation.study import Cell, Study, Table
from .domains import SIMULATED
from .pairs import Roc
from .published import GENERALIZATION, METHODS
from .transfer import SHIPPED, TITLES, Plan, Transfer
from .workspace import Workspace

NAME = "generalization"
Areas = dict[tuple[str, str], dict[str, Roc]]

_TEXT = """\
Each method is trained on each of three simulated surroundings, and tested on all of them: a town \
seen by a spinning LiDAR, a meadow and a town swept by a push-broom one. Figures are the areas \
under the ROC over pairs of segments of different sessions. No place is both trained and tested on.

The weights that come with the package stand beside: they were trained for longer, on simulated \
worlds of which none is a test here. Where KITTI 00 is at hand, all are also tested on real scans, \
and trained on others of its places."""


def run(workspace: Workspace, plan: Plan | None = None) -> Study:
    """Compute areas under the ROC for every method, training set and test set.

    Parameters
    ----------
    plan : Plan, optional
        By default that of the workspace's scale.
    """
    start = time.monotonic()
    transfer = Transfer(workspace, plan)
    tests = transfer.domains.names
    transfer.prepare(tests)
    areas = transfer.curves([(source, test) for test in tests for source in _sources(test)])
    facts = workspace.facts(time.monotonic() - start, transfer.fingerprints)
    facts["steps"] = dict(transfer.plan.effort.steps)
    tables = (*_tables(transfer, areas), _published())
    return Study(NAME, "Trained here, used there", tables, (), facts, _TEXT)


def _sources(test: str) -> tuple[str, ...]:
    """Return the training sets for a test set, its own first."""
    return (test, *(name for name in SIMULATED if name != test), SHIPPED)


def _tables(transfer: Transfer, areas: Areas) -> tuple[Table, ...]:
    steps = ", ".join(f"{name} {count}" for name, count in transfer.plan.effort.steps.items())
    note = (
        "Pairs match by centroids within 0.5 m and differ beyond 20 m, as in the paper. Steps of "
        f"training: {steps}. Shipped weights come with their FC4; geo learns nothing, "
        "and of methods that are empty there nothing is shipped. Shipped forests were grown to "
        "prune near candidates, not to judge any pair."
    )
    best: dict[str, float] = {}
    for (_, test), row in areas.items():
        best[test] = max([best.get(test, 0.0), *(curve.area.value for curve in row.values())])

    def table(name: str, title: str, note: str, cell: Callable[[str, Roc], Cell]) -> Table:
        rows = tuple(
            (
                TITLES[test],
                TITLES[source],
                *(cell(test, row[m]) if m in row else None for m in transfer.methods),
            )
            for (source, test), row in areas.items()
        )
        columns = ("test", "trained on", *transfer.methods)
        return Table(name, title, columns, rows, note)

    def area(_: str, curve: Roc) -> Cell:
        return round(curve.area.value, 4)

    def share(test: str, curve: Roc) -> Cell:
        return round(100 * curve.area.value / best[test])

    def interval(_: str, curve: Roc) -> Cell:
        return f"{curve.area.low:.3f} to {curve.area.high:.3f}"

    return (
        table("generalization", "Area under the ROC", note, area),
        table(
            "generalization_percent",
            "The same in per cent of the best of each test set",
            "Of all methods and training sets.",
            share,
        ),
        table(
            "generalization_intervals",
            "95 % intervals of the areas",
            "By bootstrap over places: worlds, or squares of 100 m where there are few.",
            interval,
        ),
    )


def _published() -> Table:
    names = {"kitti": "KITTI", "burgess": "Burgess Field", "robotcar": "RobotCar"}
    rows: list[tuple[Cell, ...]] = [
        (names[test], names[train], *areas) for test, train, areas in GENERALIZATION
    ]
    note = "Table I. Other recordings, labels and trainings: compare ranks and losses, not values."
    columns = ("test", "trained on", *METHODS)
    return Table("generalization-paper", "Area under the ROC", columns, tuple(rows), note, "paper")
