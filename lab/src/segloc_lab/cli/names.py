"""What commands share: the option of a report, and lists of names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from segloc.errors import ConfigError

Report = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="New folder for a dated report.")
]


def split_names(given: str | None, option: str = "--methods") -> tuple[str, ...] | None:
    """Split a list of names separated by commas."""
    if given is None:
        return None
    names = tuple(name.strip() for name in given.split(","))
    if not all(names):
        raise ConfigError(f"{option} {given!r}: empty name")
    return names
