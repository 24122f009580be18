"""``segloc evaluate``: the studies of the paper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from segloc.cli.console import note, progress, say
from segloc.errors import ConfigError, DatasetError, MissingDependency

from . import evaluate as own

if TYPE_CHECKING:
    from ..evaluation.report.study import Study
    from ..studies.paper.workspace import Workspace


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
    from ..studies.kitti_paper import counts, differences
    from ..studies.kitti_paper import stored as read

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
    from ..studies.kitti_paper import DRAWS, answers_of

    if kitti is None:
        raise ConfigError("which recording is to be localized? --kitti DATA")
    if not (kitti / "keyframes").is_dir():
        raise DatasetError(f"{kitti / 'keyframes'}: no such folder; --kitti needs keyframes")
    chosen = ready(own.chosen(methods))
    if chosen.left_out:
        note(chosen.note())
    return answers_of(chosen.names, kitti, folder, say, verify, workers, draws or DRAWS)


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
    from ..studies.paper import workspace as studies

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
    from ..studies.paper import workspace as studies

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
