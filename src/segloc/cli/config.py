"""``segloc config``"""

from __future__ import annotations

from typing import Annotated

import typer

from .options import Method


def config(
    method: Method = None,
    every: Annotated[
        bool, typer.Option("--all", help="Also what the confidence was fitted under.")
    ] = False,
) -> None:
    """Print the configuration as YAML, with what each key means beside its default."""
    from ..config import Config

    print(Config.load(None, method).explained(every), end="")
