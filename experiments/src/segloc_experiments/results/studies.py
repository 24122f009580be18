"""Tables of the studies of the paper, as they are kept with the code that made them."""

from __future__ import annotations

from collections.abc import Iterator

from segloc.batch.report.study import Study, Table

from .fingerprints import COMPARING, DESCRIBING
from .store import Result

TIMED = ("localization", "timing")
"""Studies of whole queries; the others are of descriptors, most of which they train."""
USUAL = ("six", "full", None)
"""The suite, the scale and the data of which a result is named after its table alone."""


def kept(study: Study) -> Iterator[Result]:
    """Its own tables; published figures that stand beside them are in no need of it."""
    stages = COMPARING if study.name in TIMED else (*DESCRIBING, "training")
    facts = study.facts
    of = (facts["suite"], facts["scale"], facts["data"])
    command = f"segloc evaluate {study.name} --suite {of[0]} --scale {of[1]}"
    command += "" if of[2] is None else " --kitti DATA"
    # By "method", or "method, what it was trained on".
    methods = sorted({name.split(",")[0] for name in facts["fingerprints"]})
    for table in study.tables:
        if table.source == "segloc":
            yield Result.measured(
                _named(table, of),
                f"{command} --store docs/results",
                table.columns,
                table.rows,
                stages=stages,
                methods=methods,
                note=table.note,
            )


def _named(table: Table, of: tuple[str, str, str | None]) -> str:
    name = f"paper-{table.name}".replace("_", "-")
    return name if of == USUAL else "-".join([name, *(part for part in of if part)])
