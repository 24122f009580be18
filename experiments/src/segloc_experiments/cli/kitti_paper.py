"""``segloc evaluate kitti-paper``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from segloc.cli import evaluate as own
from segloc.cli.console import note, say, table
from segloc.errors import DatasetError

DEFAULT = "segmatch-eigen,nsm,segmap,esm,dsm,geo,profile"


def kitti_paper(
    kitti: Annotated[Path, typer.Option(metavar="DATA", help="KITTI 00: keyframes, scans, poses.")],
    out: own.Out = own.OUT,
    methods: own.Methods = DEFAULT,
    verify: Annotated[
        bool, typer.Option(help="Also with our verification, which takes three times as long.")
    ] = True,
    store: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Also keep the tables there, as JSON.")
    ] = None,
) -> None:
    """The paper's own protocol on KITTI 00, with and without our verification. (Table II)

    Everything before the last 1300 m is mapped, and a cloud every 9.7 m of the rest is localized.
    K is chosen for each method at other places, and so is the number of inliers that is believed.
    """
    from segloc.batch.methods import ready

    from ..kitti_paper.protocol import answers_of
    from ..kitti_paper.tables import counts, differences

    if not (kitti / "keyframes").is_dir():
        raise DatasetError(f"{kitti / 'keyframes'}: no such folder; --kitti needs keyframes")
    chosen = ready(own.chosen(methods))
    if chosen.left_out:
        note(chosen.note())
    answers = answers_of(chosen.names, kitti, out / "kitti-paper", say, verify)
    command = f"segloc evaluate kitti-paper --kitti DATA --methods {','.join(chosen.names)}"
    command += "" if verify else " --no-verify"
    results = [counts(answers, command)]
    if "dsm" in chosen.names:
        results.append(differences(answers, command))
    for result in results:
        rows = [tuple("-" if cell is None else str(cell) for cell in row) for row in result.rows]
        table(result.note, result.columns, rows)
        if store is not None:
            say(f"stored in {result.save(store)}")
