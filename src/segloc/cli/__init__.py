"""The command line: one module a verb. Heavy imports happen inside the verbs."""

from __future__ import annotations

import atexit
import signal
import sys
from importlib.metadata import entry_points
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from ..errors import SeglocError
from . import (
    align,
    config,
    demo,
    doctor,
    evaluate,
    explain,
    export,
    info,
    live,
    localize,
    map_build,
    map_info,
    map_merge,
    map_tile,
    map_update,
    odometry,
    sample,
    simulate,
    view,
)
from .train import train

_INTERRUPTED = 130  # as shells have it: 128 and the signal's number
_CONTEXT = {"help_option_names": ["-h", "--help"]}

ORDER = (
    *("demo", "sample", "doctor", "info", "odometry", "map", "localize", "explain", "view"),
    *("live", "align", "export", "evaluate", "simulate", "train", "config"),
)
"""Verbs in the order in which they are met; those of other distributions follow."""


class InOrder(TyperGroup):
    """Lists the verbs in the order of use."""

    def list_commands(self, ctx: Any) -> list[str]:
        known = [name for name in ORDER if name in self.commands]
        return [*known, *(name for name in self.commands if name not in ORDER)]


app = typer.Typer(
    name="segloc",
    cls=InOrder,
    help="Global LiDAR localization: a pose in a prior map from one point cloud.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=_CONTEXT,
)
maps = typer.Typer(help="Build, inspect, merge and update maps.", no_args_is_help=True)
app.add_typer(maps, name="map", context_settings=_CONTEXT)
app.add_typer(train, name="train", context_settings=_CONTEXT)
app.add_typer(evaluate.app, name="evaluate", context_settings=_CONTEXT)
app.command("align")(align.align)
app.command("demo")(demo.demo)
app.command("localize")(localize.localize)
app.command("live")(live.live)
app.command("export")(export.export)
app.command("explain")(explain.explain)
app.command("view")(view.view)
app.command("sample")(sample.sample)
app.command("info")(info.info)
app.command("doctor")(doctor.doctor)
app.command("odometry")(odometry.odometry)
app.command("config")(config.config)
app.command("simulate")(simulate.simulate)
maps.command("build")(map_build.build)
maps.command("info")(map_info.info)
maps.command("merge")(map_merge.merge)
maps.command("update")(map_update.update)
maps.command("tile")(map_tile.tile)


def _add_plugins() -> None:
    """Add the verbs of other distributions, by entry points ``segloc.commands``: register(app)."""
    for plugin in entry_points(group="segloc.commands"):
        try:
            plugin.load()(app)
        except Exception as error:  # whatever another package does must not end ours
            print(f"segloc: note: {plugin.value} cannot be loaded: {error}", file=sys.stderr)


_add_plugins()


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print it.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="With --version: all that a report of a fault needs.")
    ] = False,
) -> None:
    if version:
        _print_version(verbose)
        raise typer.Exit
    if context.invoked_subcommand is None:
        context.fail("Missing command.")


def _print_version(verbose: bool) -> None:
    from .._native import __version__  # also proves that the native module loads

    print(f"segloc {__version__}")
    if verbose:
        from ..system import versions

        print("\n".join(versions()))


def main() -> None:
    """Run the command line.

    What is the user's to mend ends as one line and exit status 1, Ctrl-C as one line and 130.
    """
    # Once all is done and said, Ctrl-C would kill Python without a word while it tidies up.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    try:
        app()
    except KeyboardInterrupt:
        _end_interrupted()
    except SystemExit as end:
        if end.code == _INTERRUPTED:  # by typer, which says nothing
            _end_interrupted()
        raise
    except Exception as error:
        if _is_interrupt(error):
            _end_interrupted()
        if not isinstance(error, (SeglocError, OSError, MemoryError)):
            raise
        print(f"segloc: error: {_one_line(error)}", file=sys.stderr)
        sys.exit(1)


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: in the middle of an import it ends as an ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _end_interrupted() -> NoReturn:
    print("segloc: interrupted", file=sys.stderr)
    sys.exit(_INTERRUPTED)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror.lower()}"
    if isinstance(error, MemoryError):
        return "out of memory"
    return " ".join(str(error).split()) or type(error).__name__
