"""Tables of the studies of the paper, as they are kept with the code that made them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..evaluation.comparison_tables import ALL, total
from ..evaluation.methods import METHODS
from ..evaluation.report.study import Study, Table
from ..simulation.suites import SUITES
from .fingerprints import COMPARING, DESCRIBING
from .store import Cell, Result

TIMED = ("localization", "timing")
"""Studies of whole queries; the others are of descriptors, most of which they train."""
_STORE = "--store docs/results"
_KEYS = ("set", "method", "estimator")
"""Columns that tell rows of localizations apart."""
USUAL = ("six", "full", None)
"""The suite, the scale and the data of which a result is named after its table alone."""


def kept(study: Study, folder: Path | None = None) -> Iterator[Result]:
    """Its own tables; published figures that stand beside them are in no need of it.

    Of a study of some test sets, or of some methods, they also have what the folder holds of others
    that the same code has measured.
    """
    stages = COMPARING if study.name in TIMED else (*DESCRIBING, "training")
    facts = study.facts
    of = (facts["suite"], facts["scale"], facts["data"])
    only = facts.get("only")
    command = f"segloc evaluate {study.name} --suite {of[0]} --scale {of[1]}"
    command += "" if of[2] is None else " --kitti DATA"
    # By "method", or "method, what it was trained on".
    methods = sorted({name.split(",")[0] for name in facts["fingerprints"]})
    for table in study.tables:
        if table.source == "segloc":
            result = Result.measured(
                _named(table, of),
                f"{command}{'' if only is None else ' --sets ' + ','.join(only)} {_STORE}",
                table.columns,
                table.rows,
                stages=stages,
                methods=methods,
                note=table.note,
            )
            merged = study.name == "localization" and table.columns[0] == "set"
            yield _with_others(result, command, of[0], folder) if merged else result


def _with_others(result: Result, command: str, suite: str, folder: Path | None) -> Result:
    """The cells of other sets and methods beside its own."""
    results = [each for each in (_before(result, folder), result) if each is not None]
    have = {name for each in results for name in each.columns}
    columns = (*_described(result), *(name for name in METHODS if name in have))
    cells: dict[tuple[Cell, ...], dict[str, Cell]] = {}
    for each in results:
        for row in each.rows:
            named = dict(zip(each.columns, row, strict=True))
            key = tuple(named[name] for name in columns if name in _KEYS)
            cells.setdefault(key, {}).update(named)
    names = [test.name for test in SUITES[suite]]
    measured = [name for name in names if any(key[0] == name for key in cells)]
    order = [*measured, *(key[0] for key in cells if key[0] not in measured)]
    rows = [
        tuple(found.get(name) for name in columns)
        for key, found in sorted(cells.items(), key=lambda each: order.index(each[0][0]))
        if key[0] != ALL
    ]
    if len(rows) < len(cells):
        rows.append(total(rows))
    sets = "" if len(measured) == len(names) else f" --sets {','.join(measured)}"
    return Result(
        result.name,
        f"{command}{sets} {_STORE}",
        ", ".join(sorted({name for each in results for name in each.commit.split(", ")})),
        {name: value for each in results for name, value in each.produced_by.items()},
        columns,
        tuple(rows),
        result.note,
    )


def _before(result: Result, folder: Path | None) -> Result | None:
    """What the folder holds of that name, if it is of the same code."""
    path = None if folder is None else folder / f"{result.name}.json"
    if path is None or not path.exists():
        return None
    before = Result.load(path)
    same = _described(before) == _described(result) and all(
        before.produced_by.get(name, value) == value for name, value in result.produced_by.items()
    )
    return before if same else None


def _described(result: Result) -> list[str]:
    """The columns that say what a row is of."""
    return [name for name in result.columns if name not in METHODS]


def _named(table: Table, of: tuple[str, str, str | None]) -> str:
    name = f"paper-{table.name}".replace("_", "-")
    return name if of == USUAL else "-".join([name, *(part for part in of if part)])
