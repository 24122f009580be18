"""``segloc evaluate``"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigError, DatasetError, MissingDependency, SeglocError

if TYPE_CHECKING:
    from ..evaluation.study import Study
    from ..evaluation.workspace import Pair, Workspace

_POSES, _ODOMETRY = Path("poses.tum"), Path("odometry.tum")
_LONG_ROWS = 40


def evaluate(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="roc, generalization, rotation, sampling, localization, timing, memory; all of "
            "them; or report, to draw again what is stored.",
        ),
    ],
    mapped: Annotated[
        Path | None,
        typer.Argument(metavar="[MAP", help="Your own recording to map (localization only)."),
    ] = None,
    query: Annotated[
        Path | None, typer.Argument(metavar="QUERY]", help="And one to localize in that map.")
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="The folder of all results.", show_default=False)
    ] = Path("evaluation"),
    suite: Annotated[str, typer.Option(metavar="NAME", help="The simulated test sets.")] = "six",
    scale: Annotated[str, typer.Option(help="small or full.")] = "small",
    kitti: Annotated[
        Path | None, typer.Option(metavar="DATA", help="KITTI 00: keyframes, scans, poses.")
    ] = None,
    methods: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Only these descriptors.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed is another world.")] = 0,
    threads: Annotated[int, typer.Option(min=0, help="Of the engine; 0: all cores.")] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    map_poses: Annotated[
        Path | None,
        typer.Option(help="Poses of MAP; poses.tum where there is one, else the recording's own."),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="Odometry of QUERY; odometry.tum where there is one, else the truth, else the "
            "recording's own."
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="True poses of QUERY in MAP's frame; poses.tum where there is one."),
    ] = None,
    map_select: Annotated[
        str | None, typer.Option(metavar="A:B[,C:D]", help="Only these scans of MAP.")
    ] = None,
    select: Annotated[
        str | None, typer.Option(metavar="A:B[,C:D]", help="Only these scans of QUERY.")
    ] = None,
    topic: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which of several topics or sensors.")
    ] = None,
    every: Annotated[
        float, typer.Option(metavar="METRES", help="Ask once in so many metres of travel.")
    ] = 10.0,
) -> None:
    """Repeat the experiments of the paper: each figure and table, beside the published figures.

    Everything is stored in DIR as it is finished, so that a run that was cut off goes on where it
    stopped; DIR/report.html shows it.
    """
    from ..evaluation import studies
    from ..evaluation.workspace import Workspace
    from .console import note, progress
    from .options import check_every
    from .results import check_folder

    names = (*studies.STUDIES, "all", "report")
    if study not in names:
        raise ConfigError(f"the study must be one of {', '.join(names)}, not {study!r}")
    check_every(every)
    check_folder(out)
    files = (map_poses, poses, truth, map_select, select, topic)
    pair = None if mapped is None else _pair(study, mapped, query, *files, every)
    chosen = None if methods is None else tuple(name.strip() for name in methods.split(","))
    workspace = Workspace(
        out,
        suite,
        scale,
        kitti,
        pair,
        seed,
        threads,
        workers,
        chosen,
        progress,
        note,
        _command(),
    )
    _ = workspace.sets  # refuses an unknown suite before the work
    if study == "all":
        _run_all(workspace)
    elif study != "report":
        _show(studies.run(study, workspace))
    _report(out, asked=study == "report")


def _run_all(workspace: Workspace) -> None:
    """Run every study; one whose packages are missing is left out with a remark."""
    from ..evaluation import studies
    from .console import note, say

    for name in studies.STUDIES:
        say(f"segloc evaluate {name}")
        try:
            studies.run(name, workspace)
        except MissingDependency as error:
            note(f"{name} is left out: {error}")


def _report(out: Path, asked: bool) -> None:
    """Draw what is stored; where nobody asked for it, a missing package is but a remark."""
    from ..evaluation.report import write
    from ..evaluation.studies import STORED
    from ..evaluation.study import stored
    from .console import note

    found = list(stored(out, STORED))
    if not found:
        raise SeglocError(f"{out}: holds no study; run one first")
    try:
        write(out, found)
    except MissingDependency as error:
        if asked:
            raise
        note(f"no report.html: {error}")
        return
    print(f"{out / 'report.html'} shows {', '.join(study.name for study in found)}")


def _pair(
    study: str,
    mapped: Path,
    query: Path | None,
    map_poses: Path | None,
    poses: Path | None,
    truth: Path | None,
    map_select: str | None,
    select: str | None,
    topic: str | None,
    every: float,
) -> Pair:
    from ..evaluation.workspace import Pair

    if query is None:
        raise ConfigError("give two recordings, one to map and one to localize in it")
    if study != "localization":
        raise ConfigError(f"only localization takes recordings of your own, not {study}")
    for path in (mapped, query):
        if not path.exists():
            raise DatasetError(f"{path}: no such file or folder")
    map_poses = map_poses or _lying_in(mapped, _POSES)
    truth = truth or _lying_in(query, _POSES)
    poses = poses or _lying_in(query, _ODOMETRY) or truth
    return Pair(mapped, query, map_poses, poses, truth, map_select, select, topic, every)


def _lying_in(folder: Path, name: Path) -> Path | None:
    return folder / name if (folder / name).is_file() else None


def _command() -> str:
    import shlex

    return shlex.join(["segloc", *sys.argv[1:]])


def _show(study: Study) -> None:
    """Print the tables that fit on a screen."""
    from ..evaluation.tables import plain

    for table in study.tables:
        if len(table.rows) <= _LONG_ROWS:
            published = " (published)" if table.source == "paper" else ""
            print(f"{table.title}{published}\n{plain(table)}\n")
