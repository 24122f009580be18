"""``segloc evaluate kitti-paper``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from segloc.cli.console import note, say
from segloc.errors import ConfigError, DatasetError

from . import evaluate as own

Report = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="New folder for a dated report.")
]


def kitti_paper(
    kitti: Annotated[
        Path | None, typer.Option(metavar="DATA", help="KITTI 00: keyframes and their poses.")
    ] = None,
    out: own.Out = own.OUT,
    methods: own.Methods = None,
    verify: Annotated[
        bool, typer.Option(help="Also with our verification, which takes three times as long.")
    ] = True,
    workers: own.Workers = 2,
    draws: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="COUNT", help="Maximum number of PROSAC samples.", show_default="2000000"
        ),
    ] = None,
    stored: Annotated[
        bool, typer.Option("--stored", help="Only print the tables of stored results.")
    ] = False,
    report: Report = None,
) -> None:
    """The paper's own protocol on KITTI 00, with and without our verification. (Table II)

    Everything before the last 1300 m is mapped, and a cloud every 9.7 m of the rest is localized.
    K is chosen for each method at other places, and so is the number of inliers that is believed.
    """
    from ..report import publish, require_new
    from ..studies.kitti_paper.protocol import stored as read
    from ..studies.kitti_paper.tables import counts, differences

    require_new(report)
    folder = out / "kitti-paper"
    answers = read(folder) if stored else _measured(kitti, folder, methods, verify, workers, draws)
    tables = [counts(answers)]
    if "dsm" in answers:
        tables.append(differences(answers))
    publish(report, "The paper's protocol on KITTI 00", *tables)


def _measured(
    kitti: Path | None,
    folder: Path,
    methods: str | None,
    verify: bool,
    workers: int,
    draws: int | None,
) -> dict[str, Any]:
    from ..evaluation.methods import ready
    from ..studies.kitti_paper.answers import DRAWS
    from ..studies.kitti_paper.protocol import answers_of

    if kitti is None:
        raise ConfigError("which recording is to be localized? --kitti DATA")
    if not (kitti / "keyframes").is_dir():
        raise DatasetError(f"{kitti / 'keyframes'}: no such folder; --kitti needs keyframes")
    chosen = ready(own.chosen(methods))
    if chosen.left_out:
        note(chosen.note())
    return answers_of(chosen.names, kitti, folder, say, verify, workers, draws or DRAWS)
