"""The verbs; only the requested one is imported."""

from __future__ import annotations

import re
import sys
from functools import cache
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ...errors import INSTALL_LAB, SeglocError
from ...system.plugins import plugins

HELP_NAMES = {"help_option_names": ["-h", "--help"]}
ORDER = (
    "demo",
    "sample",
    "doctor",
    "info",
    "odometry",
    "map",
    "localize",
    "explain",
    "view",
    "live",
    "align",
    "export",
    "config",
)
"""Verbs in order of use; those of other distributions follow."""

LABORATORY = ("evaluate", "simulate", "train", "bench")
"""Verbs that ``segloc-lab`` adds."""

MAPS = ("build", "from-cloud", "from-mesh", "info", "merge", "update", "tile")
VERSION = "--version"
"""Option without a verb."""


def first_sentence(text: str) -> str:
    """Return the first sentence of a help text. "Fig. 5" does not end it."""
    paragraph = " ".join(text.strip().split("\n\n")[0].split())
    return re.split(r"(?<=[.?!])\s+(?=[A-Z])", paragraph, maxsplit=1)[0]


class Listed(TyperGroup):
    """List verbs with their complete first sentence."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        verbs = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [(name, first_sentence(verb.help or "")) for name, verb in verbs if verb]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def group(text: str, cls: type[Listed] = Listed, **settings: Any) -> typer.Typer:
    """Create a group of verbs; without a verb it shows its help.

    Help is plain text: importing ``rich`` for frames takes longer than everything else.
    """
    return typer.Typer(
        help=text,
        cls=cls,
        no_args_is_help=True,
        rich_markup_mode=None,
        context_settings=HELP_NAMES,
        **settings,
    )


class InOrder(Listed):
    """List the verbs in order of use."""

    def list_commands(self, ctx: Any) -> list[str]:
        known = [name for name in ORDER if name in self.commands]
        return [*known, *(name for name in self.commands if name not in ORDER)]


@cache
def program(verb: str | None = None) -> typer.Typer:
    """Create the command line, with a single verb if it is known.

    Parameters
    ----------
    verb : str, optional
        Unknown names load all verbs; ``VERSION`` loads none.

    Returns
    -------
    typer.Typer
    """
    if verb == VERSION:
        names: tuple[str, ...] = ()
    elif verb in ORDER:
        names = (verb,)
    elif verb is None:
        names = ORDER
    else:
        return program()
    app = group(
        "Global LiDAR localization: a pose in a prior map from one point cloud.",
        InOrder,
        name="segloc",
        pretty_exceptions_enable=False,
    )
    app.callback(invoke_without_command=True)(root)
    for name in names:
        _add(app, name)
    if verb is None:
        _add_plugins(app)
    return app


def _add(app: typer.Typer, name: str) -> None:
    if name == "map":
        maps = group("Build, inspect, merge and update maps.")
        for inner in MAPS:
            function = inner.replace("-", "_")
            maps.command(inner)(_member(f"map_{function}", function))
        app.add_typer(maps, name=name, context_settings=HELP_NAMES)
    else:
        app.command(name)(_member(name, name))


def _member(module: str, name: str) -> Any:
    return getattr(import_module(f".{module}", __package__), name)


def _add_plugins(app: typer.Typer) -> None:
    """Add the verbs of other distributions, by entry points ``segloc.commands``: register(app)."""
    loaded, faults = plugins("segloc.commands")
    for name, register in loaded.items():
        try:
            register(app)
        except Exception as error:  # a faulty plug-in must not end the program
            faults = {**faults, name: str(error)}
    for name, fault in faults.items():
        print(f"segloc: note: the plug-in {name} cannot be loaded: {fault}", file=sys.stderr)
    present = {command.name for command in app.registered_commands}
    present |= {inner.name for inner in app.registered_groups}
    for name in LABORATORY:
        if name not in present:
            _add_missing(app, name)


def _add_missing(app: typer.Typer, name: str) -> None:
    """Add a hidden verb that names the distribution it belongs to."""

    def missing() -> None:
        raise SeglocError(f"`segloc {name}` belongs to segloc-lab: {INSTALL_LAB}")

    settings = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
    app.command(name, hidden=True, context_settings=settings)(missing)


def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option(VERSION, help="Show the version and exit.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="With --version: also print what a bug report needs.")
    ] = False,
) -> None:
    if version:
        _print_version(verbose)
        raise typer.Exit
    if context.invoked_subcommand is None:
        context.fail("Missing command.")


def _print_version(verbose: bool) -> None:
    from ..._native import __version__

    print(f"segloc {__version__}")
    if verbose:
        from .machine import versions

        print("\n".join(versions()))
