"""Output of verbs: progress on stderr, tables on stdout."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

_UNWRAPPED = 10_000  # columns
SECONDS_A_LINE = 10.0
"""Minimum time between two lines of progress if stderr is not a terminal [s]."""

Update = Callable[[int, int], None]


@contextmanager
def progress(label: str) -> Iterator[Update]:
    """Show a progress bar on stderr, advanced by calling ``update(done, total)``.

    Without a terminal, print a line at most every ``SECONDS_A_LINE``, and one at the end of work
    that takes longer.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(label)
        return
    count = TextColumn(
        "{task.fields[count]}", style="progress.download"
    )  # set with the first update
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        count,
        TimeRemainingColumn(),
        console=console,
    ) as bars:
        task = bars.add_task(label, total=None, count="")

        def update(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total, count=f"{done}/{total}")

        yield update


def _lines(label: str) -> Update:
    last, has_begun = time.monotonic(), False

    def update(done: int, total: int) -> None:
        nonlocal last, has_begun
        now = time.monotonic()
        if has_begun if done == total else now - last >= SECONDS_A_LINE:
            last, has_begun = now, done < total
            say(f"{label}: {done} of {total}")

    return update


@contextmanager
def busy(label: str) -> Iterator[None]:
    """Show a spinner on stderr; nothing without a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(label):
        yield


def note(text: str) -> None:
    """Print a remark to stderr; on one line without a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    wrapped = console.is_terminal
    console.print(f"segloc: note: {text}", markup=False, highlight=False, soft_wrap=not wrapped)


def say(text: str) -> None:
    """Print a line of progress to stderr."""
    print(text, file=sys.stderr, flush=True)


def table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    texts: Sequence[int] = (0,),
) -> None:
    """Print a table: text in the first column, or in ``texts``, and numbers in the others.

    Nothing is wrapped if stdout is not a terminal.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        console = Console(width=_UNWRAPPED)
    console.print(Text(title, style="bold"), soft_wrap=True)  # a table's own title would wrap
    shown = Table(show_header=any(header))
    for i, name in enumerate(header):
        shown.add_column(name, justify="left" if i in texts else "right", overflow="fold")
    for row in rows:
        shown.add_row(*row)
    console.print(shown)
