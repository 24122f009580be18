"""``segloc bench``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from segloc.errors import ConfigError

if TYPE_CHECKING:
    from ..bench.comparing import Change
    from ..bench.harness import Row


def bench(
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the measurements here, too.")
    ] = None,
    only: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Only these benchmarks.")
    ] = None,
    threads: Annotated[
        str, typer.Option(metavar="N,...", help="Each benchmark runs once with each number.")
    ] = "1,2",
    repeats: Annotated[int, typer.Option(min=1, help="Runs of which the median is taken.")] = 9,
    compare: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Print what became slower since it was written."),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Keep the tables of the documentation here."),
    ] = None,
) -> None:
    """Time the engine against other software, in turns, and against the processor's own limits.

    Rivals that are not installed are left out; segloc-lab[bench] brings them.
    """
    import os

    from segloc.cli.console import busy, note
    from segloc.system.machine import processor

    from ..bench.comparing import compared, read_json
    from ..bench.rows import write_json
    from ..bench.stored import stored
    from ..bench.suite import BENCHMARKS, run

    before = None if compare is None else read_json(compare)
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
    if json is not None:
        write_json(json, rows)
    if store is not None:
        chosen = "" if only is None else f" --only {only}"
        command = f"segloc bench{chosen} --threads {threads} --repeats {repeats}"
        for result in stored(rows, command, machine):
            result.save(store)
    if before is not None:
        _show_changes(compared(before, rows))


def _isa() -> str:
    from segloc._native import instruction_set

    return instruction_set()


def _names(only: str | None, every: list[str]) -> list[str]:
    return every if only is None else [name.strip() for name in only.split(",")]


def _numbers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"--threads must be numbers joined by commas, not {text!r}") from error


def _show_changes(changes: list[Change]) -> None:
    from segloc.cli.console import table

    from ..bench.comparing import change_rows

    head = ("", "before, ms", "now, ms", "times", "against rivals")
    table("Since then", head, change_rows(changes))
    slower = [f"{c.name} ({c.threads})" for c in changes if c.is_slower]
    print(f"slower: {', '.join(slower)}" if slower else "nothing became slower")


def _show(rows: list[Row], title: str) -> None:
    from segloc.cli.console import table

    from ..bench.rows import table_rows

    lines = [line for row in rows for line in table_rows(row)]
    table(title, ("", "ms", "ratio"), lines)
    for row in rows:
        if row.details:
            text = ", ".join(f"{name} {value:.4g}" for name, value in row.details.items())
            print(f"{row.name}, {row.threads} thread{'s' * (row.threads > 1)}: {text}")
