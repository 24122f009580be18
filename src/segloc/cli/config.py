"""``segloc config``"""

from __future__ import annotations

from typing import Annotated

import typer


def config(
    method: Annotated[
        str | None, typer.Option(metavar="NAME", help="How segments are described.")
    ] = None,
) -> None:
    """Print the whole configuration as YAML, every default written out."""
    from ..config import Config

    print(Config.load(None, method).to_yaml(), end="")
