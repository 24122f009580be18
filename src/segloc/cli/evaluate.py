"""``segloc evaluate``"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigError, DatasetError, MissingDependency, SeglocError
from . import failures

if TYPE_CHECKING:
    from ..evaluation.study import Study
    from ..evaluation.workspace import Pair, Workspace

_POSES, _ODOMETRY = Path("poses.tum"), Path("odometry.tum")
_LONG_ROWS = 40
_EXPLAINED = {
    "roc": "Which descriptor tells whether two segments are of one object? (Fig. 5)",
    "generalization": "And in a place of another kind than it was trained on? (Table I)",
    "rotation": "Does a descriptor change when its segment is turned? (Fig. 6)",
    "sampling": "What does farthest-point sampling cost, and what does it bring?",
    "timing": "How long does a query take, and where does the time go? (Table III)",
    "memory": "How much memory does training take?",
    "all": "Every study, one after the other.",
}

Out = Annotated[
    Path, typer.Option(metavar="DIR", help="The folder of all results.", show_default=False)
]
Suite = Annotated[str, typer.Option(metavar="NAME", help="The simulated test sets.")]
Scale = Annotated[str, typer.Option(help="small or full.")]
Kitti = Annotated[
    Path | None, typer.Option(metavar="DATA", help="KITTI 00: keyframes, scans, poses.")
]
Methods = Annotated[str | None, typer.Option(metavar="NAME,...", help="Only these descriptors.")]
Seed = Annotated[int, typer.Option(min=0, help="Another seed is another world.")]
Threads = Annotated[int, typer.Option(min=0, help="Of the engine; 0: all cores.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes.")]
_OUT = Path("evaluation")

evaluate = typer.Typer(
    help="Repeat the experiments of the paper: each figure and table, beside the published figures."
    " Everything is stored in DIR as it is finished, so that a run that was cut off goes on where"
    " it stopped; DIR/report.html shows it.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _add(name: str) -> None:
    def command(
        out: Out = _OUT,
        suite: Suite = "six",
        scale: Scale = "small",
        kitti: Kitti = None,
        methods: Methods = None,
        seed: Seed = 0,
        threads: Threads = 1,
        workers: Workers = 2,
    ) -> None:
        _run(name, _workspace(out, suite, scale, kitti, None, methods, seed, threads, workers))

    command.__doc__ = _EXPLAINED[name]
    evaluate.command(name)(command)


for _name in _EXPLAINED:
    _add(_name)


@evaluate.command("localization")
def localization(
    mapped: Annotated[
        Path | None, typer.Argument(metavar="[MAP", help="Your own recording to map.")
    ] = None,
    query: Annotated[
        Path | None, typer.Argument(metavar="QUERY]", help="And one to localize in that map.")
    ] = None,
    out: Out = _OUT,
    suite: Suite = "six",
    scale: Scale = "small",
    kitti: Kitti = None,
    methods: Methods = None,
    seed: Seed = 0,
    threads: Threads = 1,
    workers: Workers = 2,
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
    """How many queries are localized, and how many of them falsely? (Table II)"""
    from .options import check_every

    check_every(every)
    files = (map_poses, poses, truth, map_select, select, topic)
    pair = None if mapped is None else _pair(mapped, query, *files, every)
    given = (suite, scale, kitti, pair, methods, seed, threads, workers)
    _run("localization", _workspace(out, *given))


@evaluate.command("report")
def report(out: Out = _OUT) -> None:
    """Draw again what is stored."""
    from .results import check_folder

    check_folder(out)
    _report(out, asked=True)


failures.register(evaluate)


def _workspace(
    out: Path,
    suite: str,
    scale: str,
    kitti: Path | None,
    pair: Pair | None,
    methods: str | None,
    seed: int,
    threads: int,
    workers: int,
) -> Workspace:
    from ..evaluation.workspace import Workspace
    from .console import note, progress
    from .results import check_folder

    check_folder(out)
    chosen = None if methods is None else tuple(name.strip() for name in methods.split(","))
    settings = (suite, scale, kitti, pair, seed, threads, workers, chosen)
    return Workspace(out, *settings, progress, note, _command())


def _run(study: str, workspace: Workspace) -> None:
    from ..evaluation import studies

    _ = workspace.sets  # refuses an unknown suite before the work
    if study == "all":
        _run_all(workspace)
    else:
        _show(studies.run(study, workspace))
    _report(workspace.out, asked=False)


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
