"""``segloc config``"""

from __future__ import annotations

from typing import Annotated

import typer


def config(
    method: Annotated[
        str | None, typer.Option(metavar="NAME", help="How segments are described.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Also what the confidence was fitted under.")
    ] = False,
) -> None:
    """Print the configuration as YAML, with what each key means beside its default."""
    from ..config import Config

    print(Config.load(None, method).explained(every), end="")
