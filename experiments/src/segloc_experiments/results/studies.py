"""Tables of the studies of the paper, as they are kept with the code that made them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from segloc.batch.comparison_tables import ALL, total
from segloc.batch.report.study import Study, Table
from segloc.simulation.suites import SUITES

from .fingerprints import COMPARING, DESCRIBING
from .store import Result

TIMED = ("localization", "timing")
"""Studies of whole queries; the others are of descriptors, most of which they train."""
USUAL = ("six", "full", None)
"""The suite, the scale and the data of which a result is named after its table alone."""


def kept(study: Study, folder: Path | None = None) -> Iterator[Result]:
    """Its own tables; published figures that stand beside them are in no need of it.

    Of a study of some test sets they also have the rows of others that the same code has measured
    and that the folder holds; what sums up all sets is not kept of some.
    """
    stages = COMPARING if study.name in TIMED else (*DESCRIBING, "training")
    facts = study.facts
    of = (facts["suite"], facts["scale"], facts["data"])
    command = f"segloc evaluate {study.name} --suite {of[0]} --scale {of[1]}"
    command += "" if of[2] is None else " --kitti DATA"
    # By "method", or "method, what it was trained on".
    methods = sorted({name.split(",")[0] for name in facts["fingerprints"]})
    some = facts.get("only") is not None
    for table in study.tables:
        if table.source == "segloc" and (table.columns[0] == "set" or not some):
            result = Result.measured(
                _named(table, of),
                f"{command} --store docs/results",
                table.columns,
                table.rows,
                stages=stages,
                methods=methods,
                note=table.note,
            )
            yield _with_other_sets(result, of[0], folder) if some else result


def _with_other_sets(result: Result, suite: str, folder: Path | None) -> Result:
    names = [test.name for test in SUITES[suite]]
    rows, commits = [row for row in result.rows if row[0] != ALL], {result.commit}
    before = _before(result, folder)
    if before is not None:
        own = {row[0] for row in rows}
        rows += [row for row in before.rows if row[0] not in {*own, ALL}]
        commits.update(before.commit.split(", "))
    found = {row[0] for row in rows}
    measured = [name for name in names if name in found]
    rows.sort(key=lambda row: measured.index(str(row[0])) if row[0] in measured else len(names))
    if any(row[0] == ALL for row in result.rows):
        rows.append(total(rows))
    command = result.command
    if len(measured) < len(names):
        command = command.replace(" --store", f" --sets {','.join(measured)} --store")
    return replace(result, command=command, commit=", ".join(sorted(commits)), rows=tuple(rows))


def _before(result: Result, folder: Path | None) -> Result | None:
    """What the folder holds of that name, if it is of the same code."""
    path = None if folder is None else folder / f"{result.name}.json"
    if path is None or not path.exists():
        return None
    before = Result.load(path)
    same = (before.produced_by, before.columns) == (result.produced_by, result.columns)
    return before if same else None


def _named(table: Table, of: tuple[str, str, str | None]) -> str:
    name = f"paper-{table.name}".replace("_", "-")
    return name if of == USUAL else "-".join([name, *(part for part in of if part)])
