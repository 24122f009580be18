"""``segloc config``"""

from __future__ import annotations

from typing import Annotated

import typer

from . import options


def config(
    method: options.Method = None,
    every: Annotated[
        bool,
        typer.Option("--all", help="Also print the settings that the confidence was fitted with."),
    ] = False,
) -> None:
    """Print the configuration as YAML, with defaults and the meaning of each key."""
    from ...config import Config

    print(Config.load(None, method).explained(every), end="")
