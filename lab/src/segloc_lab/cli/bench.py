"""``segloc bench``"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from segloc.errors import ConfigError

from .names import Report

if TYPE_CHECKING:
    from ..bench.harness import Row
    from ..report import Cell

KERNELS = {
    "gravity": "front",
    "ground": "front",
    "clustering": "geometric",
    "description": "front",
    "knn": "geometric",
    "pose": "geometric",
    "overlap": "geometric",
    "icp": "geometric",
    "fps": "fps",
    "network": "network",
    "dsm_vs_esm": "network",
}
"""Modules of ``segloc_lab.bench`` by kernel; each is timed beside other software and its bound."""

WORKS = (
    "stages",
    "query",
    "million",
    "tiles",
    "accumulated",
    "os1_128",
    "build",
    "align",
    "stream",
    "stream_os1_128",
    "stream_vlp16",
)
"""Whole work, in ``segloc_lab.bench.works``; it is timed beside other versions.

Each is made of a folder of real recordings, or simulated.
"""


def kernel(name: str) -> Callable[[int, int], Row]:
    """Load the benchmark of a kernel: a function of (threads, repeats)."""
    found: Callable[[int, int], Row] = getattr(
        import_module(f"segloc_lab.bench.{KERNELS[name]}"), name
    )
    return found


@dataclass(frozen=True)
class Plan:
    """What is timed.

    Attributes
    ----------
    names : tuple of str
        Of :data:`KERNELS` and :data:`WORKS`.
    threads : tuple of int
        Numbers of threads.
    repeats : int
        Runs; the median counts.
    data : Path or None
        Folder of real recordings.
    against : Path or None
        Interpreter or wheel of another version, for works.
    """

    names: tuple[str, ...]
    threads: tuple[int, ...] = (1,)
    repeats: int = 9
    data: Path | None = None
    against: Path | None = None

    def __post_init__(self) -> None:
        known = WORKS if self.against else (*KERNELS, *WORKS)
        for name in self.names:
            if name not in known:
                beside = " beside another version" if self.against else ""
                raise ConfigError(f"no benchmark {name!r}{beside}; available: {', '.join(known)}")
        if self.repeats < 1 or min(self.threads, default=0) < 1:
            raise ConfigError("threads and repeats must be at least 1")

    def kernels(self) -> Iterator[Row]:
        """Time kernels one after another, each in its own process."""
        from ..bench.harness import in_process

        for name in self.names:
            for threads in self.threads if name in KERNELS else ():
                yield in_process(threads, kernel(name), threads, self.repeats)

    def works(self) -> Iterator[list[Sequence[Cell]]]:
        """Time whole work; yield rows of its table, work by work."""
        from ..bench.versions import commands, measure

        works = import_module("segloc_lab.bench.works")
        with commands(self.against) as versions:
            for name in self.names:
                for work in getattr(works, name)(self.data) if name in WORKS else ():
                    for threads in self.threads:
                        yield list(measure(versions, work, threads, self.repeats))


def bench(
    only: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Only these benchmarks.")
    ] = None,
    threads: Annotated[
        str, typer.Option(metavar="N,...", help="Numbers of threads to run with.")
    ] = "1",
    repeats: Annotated[int, typer.Option(min=1, help="Number of runs; the median counts.")] = 9,
    data: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Recordings; simulated without.")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="PYTHON|WHEEL", help="Another version, timed in turns; whole work only."
        ),
    ] = None,
    report: Report = None,
) -> None:
    """Compare speed with other software, the processor's limits, and other versions.

    Other software that is not installed is skipped; segloc-lab[bench] installs it.
    """
    from segloc.system.kernels import instruction_set
    from segloc.tools.cli.console import busy, note, table

    from ..bench import harness, versions
    from ..report import machine, require_new, write

    require_new(report)
    every = WORKS if against else (*KERNELS, *WORKS)
    names = every if only is None else tuple(name.strip() for name in only.split(","))
    plan = Plan(names, _numbers(threads), repeats, data, against)
    with busy("Measuring"):
        kernels = list(plan.kernels())
    _show(kernels, f"{machine()}, {instruction_set()}")
    skipped = sorted({name for row in kernels for name in row.skipped})
    if skipped:
        note(f"not installed, so not measured: {', '.join(skipped)}")
    works: list[Sequence[Cell]] = []
    measurements = plan.works()
    while True:
        with busy("Measuring"):
            rows = next(measurements, None)
        if rows is None:
            break
        table(str(rows[0][0]), versions.COLUMNS[1:], [_texts(row[1:]) for row in rows])
        works += rows
    if report is not None:
        parts = harness.tables(kernels) + versions.tables(works)
        print(write(report, "Kernels and whole work", parts))


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"--threads expects numbers separated by commas, not {text!r}") from error


def _show(kernels: Sequence[Row], title: str) -> None:
    from segloc.system.text import quantity
    from segloc.tools.cli.console import table

    from ..bench.harness import remark, table_rows

    if kernels:
        lines = [line for row in kernels for line in table_rows(row)]
        table(title, ("", "ms", "ratio"), lines)
    for row in kernels:
        if text := remark(row):
            print(f"{row.name}, {quantity(row.threads, 'threads')}: {text}")


def _texts(row: Sequence[Cell]) -> list[str]:
    return ["" if cell is None else str(cell) for cell in row]
