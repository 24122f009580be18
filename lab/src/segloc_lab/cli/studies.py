"""``segloc evaluate``: the studies of the paper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from segloc.cli.console import note, progress, say
from segloc.errors import ConfigError, MissingDependency

from . import evaluate as own
from .kitti_paper import Report, kitti_paper

if TYPE_CHECKING:
    from ..evaluation.report.study import Study
    from ..studies.paper.workspace import Workspace

_EXPLAINED = {
    "roc": "How well does each descriptor tell objects apart? (Fig. 5)",
    "generalization": "The same in a place of another kind than it was trained on. (Table I)",
    "rotation": "Does a descriptor change when its segment is turned? (Fig. 6)\n\n"
    "Trains networks: about 20 minutes on two idle cores at the small scale.",
    "sampling": "What does farthest-point sampling cost, and what does it improve?\n\n"
    "Trains networks, if they are not stored yet.",
    "timing": "How long does a query take, and where does the time go? (Table III)",
    "memory": "How much memory does training take?",
    "all": "Run all studies, one after the other.\n\n"
    "About half an hour on two idle cores at the small scale, 90 minutes at the full scale.",
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
    group = own.app
    for name in _EXPLAINED:
        _add(group, name)
    group.command("localization")(localization)
    group.command("kitti-paper")(kitti_paper)


def _add(group: typer.Typer, name: str) -> None:
    def command(
        out: own.Out = own.OUT,
        suite: Suite = "six",
        scale: Scale = "small",
        kitti: Kitti = None,
        methods: own.Methods = None,
        seed: Seed = 0,
        threads: own.Threads = 1,
        workers: own.Workers = 2,
        cluster: own.Cluster = None,
        report: Report = None,
    ) -> None:
        given = (out, suite, scale, kitti, methods, seed, threads, workers)
        with _workspace(*given, cluster) as workspace:
            _run(name, workspace, report)

    command.__doc__ = _EXPLAINED[name]
    group.command(name)(command)


def localization(
    mapped: Annotated[
        Path | None, typer.Argument(metavar="[MAP", help="Your own recording to map.")
    ] = None,
    query: Annotated[
        Path | None, typer.Argument(metavar="QUERY]", help="And one to localize in that map.")
    ] = None,
    out: own.Out = own.OUT,
    suite: Suite = "six",
    scale: Scale = "small",
    sets: Sets = None,
    kitti: Kitti = None,
    methods: own.Methods = None,
    seed: Seed = 0,
    threads: own.Threads = 1,
    workers: own.Workers = 2,
    cluster: own.Cluster = None,
    map_poses: own.MapPoses = None,
    poses: own.QueryPoses = None,
    truth: own.Truth = None,
    map_select: own.MapSelect = None,
    select: own.QuerySelect = None,
    topic: own.Topic = None,
    every: own.Every = 10.0,
    report: Report = None,
) -> None:
    """How many queries does each method localize, and how many of them falsely? (Table II)

    On two recordings of your own, or without any on the places of the paper.
    """
    if mapped is None:
        given = (out, suite, scale, kitti, methods, seed, threads, workers)
        with _workspace(*given, cluster) as workspace:
            only = None if sets is None else own.chosen(sets, "--sets")
            _run("localization", replace(workspace, only=only), report)
        return
    if query is None:
        raise ConfigError("give two recordings, one to map and one to localize in it")
    files = (map_poses, poses, truth, map_select, select, topic)
    own.compare_on(
        own.own_pair(mapped, query, *files, every), out, methods, threads, workers, cluster
    )


@contextmanager
def _workspace(
    out: Path,
    suite: str,
    scale: str,
    kitti: Path | None,
    methods: str | None,
    seed: int,
    threads: int,
    workers: int,
    cluster: str | None,
) -> Iterator[Workspace]:
    from segloc.cli.results import check_folder

    from ..studies.paper.workspace import Workspace

    check_folder(out)
    means = (seed, threads, workers, own.chosen(methods), progress, note, own.command_line())
    with own.on_cluster(cluster) as executor:
        yield Workspace(out, *means, executor, suite=suite, scale=scale, data=kitti)


def _run(study: str, workspace: Workspace, report: Path | None) -> None:
    from ..report import require_new
    from ..studies.paper import studies

    require_new(report)
    if study == "all":
        found = list(_run_all(workspace))
    else:
        say(f"segloc evaluate {study}")
        found = [studies.run(study, workspace)]
        own.show(found[0])
    if report is not None:
        _publish(report, found)
    own.write_report(workspace.out, requested=False, order=studies.STUDIES)


def _run_all(workspace: Workspace) -> Iterator[Study]:
    """Run every study; one whose packages are missing is left out with a remark."""
    from ..studies.paper import studies

    for name in studies.STUDIES:
        say(f"segloc evaluate {name}")
        try:
            yield studies.run(name, workspace)
        except MissingDependency as error:
            note(f"{name} is left out: {error}")


def _publish(folder: Path, found: list[Study]) -> None:
    """Write the tables that were measured; published figures are left out."""
    from ..report import Table, write

    tables = [
        Table(each.columns, each.rows, each.note, each.title)
        for study in found
        for each in study.tables
        if each.source == "segloc"
    ]
    say(f"stored in {write(folder, ', '.join(study.title for study in found), tables)}")
