"""``segloc evaluate peers``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from segloc.tools.cli.console import say

from .names import Report, split_names


def peers(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of sets and answers.")],
    data: Annotated[
        Path | None,
        typer.Option(metavar="DATA", help="Folder of recordings: kitti00, vlp16_corridor, ..."),
    ] = None,
    sets: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Only these sets: single, accumulated, kitti-cloud (KITTI 00), corridor, "
            "corridor-cloud, grand-loop, lab, town, forest, warehouse, offices.",
            show_default="all; without --data the last four",
        ),
    ] = None,
    peers: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Only these systems: segloc, segments (segloc by segments alone), a method of "
            "the paper, scan-context, contour-context, small-gicp, branch-and-bound, "
            "kiss-matcher, open3d, map-closures.",
            show_default="all",
        ),
    ] = None,
    every: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Every COUNT-th query of each set.")
    ] = 1,
    python: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PYTHON",
            help="Interpreter of a system with an environment of its own; repeatable.",
            show_default=False,
        ),
    ] = None,
    report: Report = None,
) -> None:
    """Compare segloc with other systems on the same clouds, one thread each.

    Sets and answers are stored in DIR; an interrupted run resumes. Systems that are not installed
    are named in the table.
    """
    from segloc.tools.cli.results import check_folder

    from ..peers.sets import SETS
    from ..peers.study import PEERS, Job, checked, interpreters
    from ..report import publish, require_new

    require_new(report)
    check_folder(out)
    names = split_names(sets, "--sets") or [n for n, s in SETS.items() if data or not s.needs]
    systems = split_names(peers, "--peers") or tuple(PEERS)
    job = Job(
        out,
        data,
        checked(names, tuple(SETS), "--sets"),
        checked(systems, tuple(PEERS), "--peers"),
        every,
        interpreters(python or ()),
        say,
    )
    publish(report, "Other systems on the same clouds", *job.run())
