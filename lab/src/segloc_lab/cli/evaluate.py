"""``segloc evaluate`` on recordings of one's own; :mod:`.studies` adds the paper's."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from segloc.cli.options import Cluster as Cluster
from segloc.cli.verbs import group
from segloc.errors import ConfigError, DatasetError, MissingDependency, SeglocError

from . import evaluate_failures

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..evaluation.report.study import Study
    from ..evaluation.scenario import Pair

OUT = Path("evaluation")
_POSES, _ODOMETRY = Path("poses.tum"), Path("odometry.tum")
_LONG_ROWS = 40

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
        metavar="NAME", help="Which of several topics or sensors.", show_default="the only one"
    ),
]
Every = Annotated[float, typer.Option(metavar="METRES", help="Distance between queries.")]

app = group(
    "Compare the methods on two recordings, and find the stage at which queries fail. Results are "
    "stored in DIR as they are computed, so an interrupted run resumes. "
    "DIR/report.html shows them.",
)
evaluate_failures.register(app)


@app.command("report")
def report(out: Out = OUT) -> None:
    """Redraw the report from stored results."""
    from segloc.cli.results import check_folder

    check_folder(out)
    write_report(out, requested=True)


def own_pair(
    mapped: Path,
    query: Path,
    map_poses: Path | None,
    poses: Path | None,
    truth: Path | None,
    map_select: str | None,
    select: str | None,
    topic: str | None,
    every: float,
) -> Pair:
    """Two recordings, with the pose files that lie in them where none are named."""
    from segloc.cli.options import check_every

    from ..evaluation.scenario import Pair

    check_every(every)
    for path in (mapped, query):
        if not path.exists():
            raise DatasetError(f"{path}: no such file or folder")
    map_poses = map_poses or _lying_in(mapped, _POSES)
    truth = truth or _lying_in(query, _POSES)
    poses = poses or _lying_in(query, _ODOMETRY) or truth
    return Pair(mapped, query, map_poses, poses, truth, map_select, select, topic, every)


def _lying_in(folder: Path, name: Path) -> Path | None:
    return folder / name if (folder / name).is_file() else None


@contextmanager
def on_cluster(address: str | None) -> Iterator[Executor | None]:
    """What does tasks on a cluster; None without an address."""
    from segloc.system.processes import executing

    with executing(1, address) as executor:
        yield executor


def compare_on(
    pair: Pair,
    out: Path,
    methods: str | None,
    threads: int,
    workers: int,
    cluster: str | None = None,
) -> None:
    """Compare the methods on two recordings, print the tables and write the report."""
    from segloc.cli.console import note, progress
    from segloc.cli.results import check_folder

    from ..evaluation.comparison_study import own_recordings
    from ..evaluation.workspace import Workspace

    check_folder(out)
    means = (0, threads, workers, chosen(methods), progress, note, command_line())
    with on_cluster(cluster) as executor:
        study = own_recordings(Workspace(out, *means, executor), pair)
    study.save(out / study.name)
    show(study)
    write_report(out, requested=False)


def chosen(given: str | None, option: str = "--methods") -> tuple[str, ...] | None:
    """The names in a list that is joined by commas.

    Raises
    ------
    ConfigError
        If a name is empty.
    """
    if given is None:
        return None
    names = tuple(name.strip() for name in given.split(","))
    if not all(names):
        raise ConfigError(f"{option} {given!r}: a name is empty")
    return names


def command_line() -> str:
    """What was typed, to be printed beside its results."""
    return shlex.join(["segloc", *sys.argv[1:]])


def write_report(out: Path, requested: bool, order: Sequence[str] = ()) -> None:
    """Draw what is stored; where nobody requested it, a missing package is but a remark.

    The studies that ``order`` names come first.
    """
    from segloc.cli.console import note

    from ..evaluation.report.html import write
    from ..evaluation.report.study import stored

    found = list(stored(out, order))
    if not found:
        raise SeglocError(f"{out}: holds no study; run one first")
    try:
        write(out, found)
    except MissingDependency as error:
        if requested:
            raise
        note(f"no report.html: {error}")
        return
    print(f"{out / 'report.html'} shows {', '.join(study.name for study in found)}")


def show(study: Study) -> None:
    """Print the tables that fit on a screen."""
    from ..evaluation.report.tables import plain

    for table in study.tables:
        if len(table.rows) <= _LONG_ROWS:
            published = " (published)" if table.source == "paper" else ""
            print(f"{table.title}{published}\n{plain(table)}\n")
