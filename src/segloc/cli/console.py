"""What a verb shows: progress on stderr, tables on stdout."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

_UNWRAPPED = 10_000  # columns
SECONDS_A_LINE = 10.0
"""Shortest time between two lines of progress where stderr is no terminal [s]."""

Update = Callable[[int, int], None]


@contextmanager
def progress(label: str) -> Iterator[Update]:
    """Show a bar on stderr that is moved by calling ``update(done, total)``.

    Without a terminal, show a line every ``SECONDS_A_LINE`` at most.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(label)
        return
    count = TextColumn("{task.fields[count]}", style="progress.download")  # once it is known
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        count,
        TimeRemainingColumn(),
        console=console,
        transient=True,
    ) as bars:
        task = bars.add_task(label, total=None, count="")

        def update(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total, count=f"{done}/{total}")

        yield update


def _lines(label: str) -> Update:
    last = time.monotonic()

    def update(done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= SECONDS_A_LINE and done < total:
            last = now
            say(f"{label}: {done} of {total}")

    return update


@contextmanager
def busy(label: str) -> Iterator[None]:
    """A sign of life on stderr; none without a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(label):
        yield


def note(text: str) -> None:
    """A remark on stderr; in one line where that is no terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    wrapped = console.is_terminal
    console.print(f"segloc: note: {text}", markup=False, highlight=False, soft_wrap=not wrapped)


def say(text: str) -> None:
    """A line of progress on stderr, as it is."""
    print(text, file=sys.stderr, flush=True)


def table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    texts: Sequence[int] = (0,),
) -> None:
    """Print a table: text in the first column, or in those named, and numbers in the others.

    Where stdout is no terminal, nothing in it is wrapped.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        console = Console(width=_UNWRAPPED)
    console.print(Text(title, style="bold"), soft_wrap=True)  # a title of the table's would wrap
    shown = Table(show_header=any(header))
    for i, name in enumerate(header):
        shown.add_column(name, justify="left" if i in texts else "right", overflow="fold")
    for row in rows:
        shown.add_row(*row)
    console.print(shown)


def number(value: float | None, unit: str = "", digits: int = 2) -> str:
    """A number with its unit, or a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}{unit and ' ' + unit}"
