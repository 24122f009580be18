"""The command line, one module per verb. Heavy imports happen inside the verbs."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from typing import TYPE_CHECKING, Any, NoReturn

from ...errors import SeglocError
from ...system.text import one_line
from .verbs import ORDER, VERSION, program

if TYPE_CHECKING:
    import typer

    app: typer.Typer

__all__ = ["ORDER", "app", "main"]
_ABOUT = {VERSION, "--verbose"}
_INTERRUPTED = 130  # exit status of shells: 128 plus the signal's number


def __getattr__(name: str) -> Any:
    """``app``: all verbs, created on access."""
    if name == "app":
        return program()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _requested_verb() -> str | None:
    """Return the verb on the command line, or ``VERSION``; None during shell completion."""
    words = sys.argv[1:]
    if not words or "_SEGLOC_COMPLETE" in os.environ:
        return None
    return VERSION if VERSION in words and _ABOUT.issuperset(words) else words[0]


def main() -> None:
    """Run the command line.

    Errors of the user end as one line and exit status 1, Ctrl-C as one line and 130.
    """
    # At the end, Ctrl-C would kill Python without a message while it cleans up.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    try:
        program(_requested_verb())()
    except KeyboardInterrupt:
        _end_interrupted()
    except SystemExit as end:
        if end.code == _INTERRUPTED:  # by typer, without a message
            _end_interrupted()
        raise
    except Exception as error:
        if _is_interrupt(error):
            _end_interrupted()
        if not isinstance(error, (SeglocError, OSError, MemoryError)):
            raise
        print(f"segloc: error: {_message(error)}", file=sys.stderr)
        sys.exit(1)


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error: during an import it becomes an ImportError."""
    visited: set[int] = set()  # causes may form a cycle
    while error is not None and id(error) not in visited:
        if isinstance(error, KeyboardInterrupt):
            return True
        visited.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def _end_interrupted() -> NoReturn:
    print("segloc: interrupted", file=sys.stderr)
    sys.exit(_INTERRUPTED)


def _message(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror.lower()}"
    if isinstance(error, MemoryError):
        return "out of memory"
    return one_line(error)
