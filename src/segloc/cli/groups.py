"""Verbs that hold others: how their help is set."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

HELP_NAMES = {"help_option_names": ["-h", "--help"]}
_WHOLE = 10_000


class Listed(TyperGroup):
    """Lists its verbs each with its whole first sentence."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        verbs = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [(name, verb.get_short_help_str(_WHOLE)) for name, verb in verbs if verb]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def group(text: str, cls: type[Listed] = Listed, **settings: Any) -> typer.Typer:
    """A group of verbs; without any it shows its help.

    Help is plain text: the frames of ``rich`` take longer to import than all else together.
    """
    return typer.Typer(
        help=text,
        cls=cls,
        no_args_is_help=True,
        rich_markup_mode=None,
        context_settings=HELP_NAMES,
        **settings,
    )
