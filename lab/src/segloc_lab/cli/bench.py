"""``segloc bench``"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from segloc.errors import ConfigError

if TYPE_CHECKING:
    from ..bench.harness import Row

BENCHMARKS = {
    "fps": "fps",
    "network": "network",
    "dsm_vs_esm": "network",
    "clustering": "geometric",
    "knn": "geometric",
    "pose": "geometric",
    "icp": "geometric",
    "query": "query",
    "stream": "stream",
    "stream_os1_128": "stream",
    "stream_vlp16": "stream",
}
"""Modules of ``segloc_lab.bench`` by benchmark."""


def benchmark(name: str) -> Callable[[int, int], Row]:
    """Load a benchmark: a function of (threads, repeats)."""
    found: Callable[[int, int], Row] = getattr(
        import_module(f"segloc_lab.bench.{BENCHMARKS[name]}"), name
    )
    return found


def run(names: Sequence[str], threads: Sequence[int], repeats: int) -> Iterator[Row]:
    """Run benchmarks one after another, each in its own process."""
    for name in names:
        if name not in BENCHMARKS:
            raise ConfigError(f"no benchmark {name!r}; available: {', '.join(BENCHMARKS)}")
    from ..bench.harness import in_process

    if repeats < 1 or min(threads, default=0) < 1:
        raise ConfigError("threads and repeats must be at least 1")
    return (
        in_process(count, benchmark(name), count, repeats) for name in names for count in threads
    )


def bench(
    only: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Only these benchmarks.")
    ] = None,
    threads: Annotated[
        str, typer.Option(metavar="N,...", help="Numbers of threads to run with.")
    ] = "1,2",
    repeats: Annotated[int, typer.Option(min=1, help="Number of runs; the median counts.")] = 9,
    report: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="New folder for a dated report.")
    ] = None,
) -> None:
    """Compare the engine's speed with other software, and with the processor's limits.

    Other software that is not installed is skipped; segloc-lab[bench] installs it.
    """
    import os

    from segloc.cli.console import busy, note
    from segloc.system.machine import processor

    from ..bench.harness import tables
    from ..report import require_new, write

    require_new(report)
    rows: list[Row] = []
    measurements = run(_names(only, list(BENCHMARKS)), _numbers(threads), repeats)
    while True:
        with busy("Measuring"):
            row = next(measurements, None)
        if row is None:
            break
        rows.append(row)
    machine = f"{processor()}, {os.cpu_count()} cores, {_isa()}"
    _show(rows, machine)
    skipped = sorted({name for row in rows for name in row.skipped})
    if skipped:
        note(f"not installed, so not measured: {', '.join(skipped)}")
    if report is not None:
        print(write(report, "Kernels, queries and streams", tables(rows)))


def _isa() -> str:
    from segloc.system.kernels import instruction_set

    return instruction_set()


def _names(only: str | None, every: list[str]) -> list[str]:
    return every if only is None else [name.strip() for name in only.split(",")]


def _numbers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"--threads expects numbers separated by commas, not {text!r}") from error


def _show(rows: list[Row], title: str) -> None:
    from segloc.cli.console import table
    from segloc.system.text import counted

    from ..bench.harness import table_rows

    lines = [line for row in rows for line in table_rows(row)]
    table(title, ("", "ms", "ratio"), lines)
    for row in rows:
        if row.details:
            text = ", ".join(f"{name} {value:.4g}" for name, value in row.details.items())
            print(f"{row.name}, {counted(row.threads, 'threads')}: {text}")
