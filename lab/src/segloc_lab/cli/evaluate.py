"""``segloc evaluate``: the studies of the paper, and comparisons on own recordings."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from segloc.errors import ConfigError, DatasetError, MissingDependency
from segloc.tools.cli.console import note, progress, say
from segloc.tools.cli.options import Cluster, check_every
from segloc.tools.cli.verbs import group

from .evaluate_failures import failures
from .evaluate_peers import peers
from .names import Report, split_names

if TYPE_CHECKING:
    from ..evaluation.study import Study
    from ..studies.paper.workspace import Workspace


Space = TypeVar("Space")

OUT = Path("evaluation")
_POSES, _ODOMETRY = Path("poses.tum"), Path("odometry.tum")

Out = Annotated[
    Path, typer.Option(metavar="DIR", help="Folder of all results.", show_default=False)
]
Methods = Annotated[
    str | None, typer.Option(metavar="NAME,...", help="Only these descriptors.", show_default="all")
]
Threads = Annotated[
    int, typer.Option(min=0, metavar="COUNT", help="Threads of the engine; 0: all cores.")
]
Workers = Annotated[int, typer.Option(min=1, metavar="COUNT", help="Processes.")]
MapPoses = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Poses of MAP.", show_default="poses.tum, else its own"),
]
QueryPoses = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Odometry of QUERY.",
        show_default="odometry.tum, else the truth, else its own",
    ),
]
Truth = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="True poses of QUERY in MAP's frame.", show_default="poses.tum"
    ),
]
MapSelect = Annotated[
    str | None,
    typer.Option(metavar="A:B[,C:D]", help="Only these scans of MAP.", show_default="all"),
]
QuerySelect = Annotated[
    str | None,
    typer.Option(metavar="A:B[,C:D]", help="Only these scans of QUERY.", show_default="all"),
]
Topic = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Topic or sensor, if there are several.", show_default="the only one"
    ),
]
Every = Annotated[float, typer.Option(metavar="METRES", help="Distance between queries.")]

app = group(
    "Repeat the studies of the paper, or compare the methods on two recordings. Results are stored "
    "in DIR as they finish; an interrupted run resumes. DIR/STUDY/REPORT.md shows them."
)


def _lying_in(folder: Path, name: Path) -> Path | None:
    return folder / name if (folder / name).is_file() else None


def command_line() -> str:
    """Return the command line, to be printed beside its results."""
    return shlex.join(["segloc", *sys.argv[1:]])


def _save(study: Study, out: Path) -> None:
    """Store a study, and show it."""
    study.save(out / study.name)
    show(study, out)


def show(study: Study, out: Path) -> None:
    """Print the tables that fit a screen, and where the study is stored."""
    from ..evaluation.study import LONG_ROWS

    for table in study.tables:
        if len(table.rows) <= LONG_ROWS:
            print(f"{table.text()}\n")
    print(f"stored in {out / study.name}")


def kitti_paper(
    kitti: Annotated[
        Path | None, typer.Option(metavar="DATA", help="KITTI 00: keyframes and their poses.")
    ] = None,
    out: Out = OUT,
    methods: Methods = None,
    verify: Annotated[
        bool, typer.Option(help="Also with our verification, which takes three times as long.")
    ] = True,
    workers: Workers = 2,
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
    """Repeat the paper's protocol on KITTI 00, with and without our verification. (Table II)

    Everything before the last 1300 m is mapped, and a cloud every 9.7 m of the rest is localized.
    K and the minimum number of inliers are chosen for each method at other places.
    """
    from ..report import require_new
    from ..studies.kitti_paper import NAME, study
    from ..studies.kitti_paper import stored as read

    require_new(report)
    folder = out / NAME
    found = study(
        read(folder)
        if stored
        else _measured(kitti, folder, split_names(methods), workers, verify, draws)
    )
    _save(found, out)
    _publish(report, [found])


def _measured(
    kitti: Path | None,
    folder: Path,
    methods: tuple[str, ...] | None,
    workers: int,
    verify: bool = True,
    draws: int | None = None,
) -> dict[str, Any]:
    from ..evaluation.comparison import ready
    from ..studies.kitti_paper import DRAWS, answers_of

    if kitti is None:
        raise ConfigError("no recording: pass --kitti DATA")
    if not (kitti / "keyframes").is_dir():
        raise DatasetError(f"{kitti / 'keyframes'}: no such folder; --kitti needs keyframes")
    selection = ready(methods)
    if selection.left_out:
        note(selection.note())
    return answers_of(selection.names, kitti, folder, say, verify, workers, draws or DRAWS)


_EXPLAINED = {
    "roc": "Measure how well each descriptor separates objects. (Fig. 5)",
    "generalization": "Measure the same at a kind of place absent from training. (Table I)",
    "rotation": "Measure how much descriptors change when segments are turned. (Fig. 6)\n\n"
    "Trains networks: about 20 minutes on two idle cores at the small scale.",
    "sampling": "Measure cost and benefit of farthest-point sampling.\n\n"
    "Trains networks, if they are not stored yet.",
    "timing": "Measure the time of a query, stage by stage. (Table III)",
    "memory": "Measure the memory of training.",
    "all": "Run all studies, one after the other.\n\n"
    "About half an hour on two idle cores at the small scale, four hours of one at the full scale.",
}

Suite = Annotated[str, typer.Option(metavar="NAME", help="Suite of simulated test sets.")]
Scale = Annotated[str, typer.Option(help="Size of the test sets: small, full or paper.")]
Kitti = Annotated[
    Path | None, typer.Option(metavar="DATA", help="KITTI 00: keyframes, scans, poses.")
]
Sets = Annotated[
    str | None,
    typer.Option(metavar="NAME,...", help="Only these test sets of the suite.", show_default="all"),
]
Seed = Annotated[int, typer.Option(min=0, help="Random seed of the worlds.")]


def register() -> None:
    """Add the studies to ``segloc evaluate``."""
    for name in _EXPLAINED:
        _add(app, name)
    app.command("localization")(localization)
    app.command("kitti-paper")(kitti_paper)
    app.command("failures")(failures)
    app.command("peers")(peers)


def _add(group: typer.Typer, name: str) -> None:
    def command(
        out: Out = OUT,
        suite: Suite = "six",
        scale: Scale = "small",
        kitti: Kitti = None,
        methods: Methods = None,
        seed: Seed = 0,
        threads: Threads = 1,
        workers: Workers = 2,
        cluster: Cluster = None,
        report: Report = None,
    ) -> None:
        from ..studies.paper.workspace import Workspace

        kind = partial(Workspace, suite=suite, scale=scale, data=kitti)
        with _workspace(kind, out, methods, seed, threads, workers, cluster) as workspace:
            _run(name, workspace, report)

    command.__doc__ = _EXPLAINED[name]
    group.command(name)(command)


def localization(
    mapped: Annotated[
        Path | None, typer.Argument(metavar="MAP", help="Own recording to map.")
    ] = None,
    query: Annotated[
        Path | None, typer.Argument(metavar="QUERY", help="Own recording to localize in that map.")
    ] = None,
    out: Out = OUT,
    suite: Suite = "six",
    scale: Scale = "small",
    sets: Sets = None,
    kitti: Kitti = None,
    methods: Methods = None,
    seed: Seed = 0,
    threads: Threads = 1,
    workers: Workers = 2,
    cluster: Cluster = None,
    map_poses: MapPoses = None,
    poses: QueryPoses = None,
    truth: Truth = None,
    map_select: MapSelect = None,
    select: QuerySelect = None,
    topic: Topic = None,
    every: Every = 10.0,
    report: Report = None,
) -> None:
    """Compare how many queries each method localizes, correctly and falsely. (Table II)

    On two own recordings, or by default on the places of the paper.
    """
    if mapped is None:
        from ..studies.paper import workspace as paper

        only = split_names(sets, "--sets")
        kind = partial(paper.Workspace, suite=suite, scale=scale, only=only, data=kitti)
        with _workspace(kind, out, methods, seed, threads, workers, cluster) as workspace:
            _run("localization", workspace, report)
        return
    if query is None:
        raise ConfigError("pass two recordings, one to map and one to localize in it")
    check_every(every)
    for path in (mapped, query):
        if not path.exists():
            raise DatasetError(f"{path}: no such file or folder")
    map_poses = map_poses or _lying_in(mapped, _POSES)
    truth = truth or _lying_in(query, _POSES)
    poses = poses or _lying_in(query, _ODOMETRY) or truth
    files = (mapped, query, map_poses, poses, truth, map_select, select, topic)
    from ..evaluation.comparison_study import compare
    from ..evaluation.scenario import Pair, PairScenario
    from ..evaluation.workspace import Workspace
    from ..report import require_new

    require_new(report)
    scenario = PairScenario(Pair(*files, every))
    with _workspace(Workspace, out, methods, 0, threads, workers, cluster) as space:
        study = compare(space, [scenario], "own", "Localization of your own recordings")
    _save(study, out)
    _publish(report, [study])


@contextmanager
def _workspace(
    kind: Callable[..., Space],
    out: Path,
    methods: str | None,
    seed: int,
    threads: int,
    workers: int,
    cluster: str | None,
) -> Iterator[Space]:
    """Yield a workspace that shows its progress on the console."""
    from segloc.system.processes import executing
    from segloc.tools.cli.results import check_folder

    check_folder(out)
    means = (seed, threads, workers, split_names(methods), progress, note, command_line())
    with executing(1, cluster) as executor:
        yield kind(out, *means, executor)


def _run(study: str, workspace: Workspace, report: Path | None) -> None:
    from ..report import require_new
    from ..studies.paper import workspace as studies

    require_new(report)
    if study == "all":
        found = list(_run_all(workspace))
    else:
        found = [studies.run(study, workspace)]
        show(found[0], workspace.out)
    _publish(report, found)


def _run_all(workspace: Workspace) -> Iterator[Study]:
    """Run every study; skip those with missing packages, with a remark."""
    from ..studies import kitti_paper
    from ..studies.paper import workspace as studies

    for name in studies.STUDIES:
        say(f"segloc evaluate {name}")
        try:
            yield studies.run(name, workspace)
        except MissingDependency as error:
            note(f"{name} skipped: {error}")
    if workspace.data is not None:
        say(f"segloc evaluate {kitti_paper.NAME}")
        folder = workspace.out / kitti_paper.NAME
        answers = _measured(workspace.data, folder, workspace.methods, workspace.workers)
        study = kitti_paper.study(answers)
        study.save(folder)
        yield study


def _publish(folder: Path | None, found: list[Study]) -> None:
    """Write a report of the studies, if asked for: published figures beside, curves drawn."""
    from ..report import write

    if folder is None:
        return
    alone = len(found) == 1
    title = found[0].title if alone else "The studies of the paper"
    parts = [part for study in found for part in study.parts(alone=alone)]
    pictures = {name: drawn for study in found for name, drawn in study.pictures().items()}
    say(f"stored in {write(folder, title, parts, pictures)}")
