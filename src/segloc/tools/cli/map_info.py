"""``segloc map info``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...system.text import json_text
from .console import table

if TYPE_CHECKING:
    from ...map.georeference import Georeference
    from ...map.segment_map import SegmentMap


def info(
    path: Annotated[str, typer.Argument(metavar="MAP", help="The map, or its tiles.")],
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show the contents of a map, and check the file for damage."""
    from ...tiles import open_map

    prior_map = open_map(path)
    facts = prior_map.info()
    if json:
        print(json_text(facts))
    else:
        table(path, ("", ""), facts.rows())


def save_and_show(prior_map: SegmentMap, out: Path, where: Georeference | None) -> None:
    """Save a new map with its georeference, and print its contents."""
    from ...map.georeference import KEY
    from .results import writing

    if where is not None:
        prior_map.metadata[KEY] = where.to_text()
    with writing(out):
        prior_map.save(out)
    show(prior_map, str(out))


def show(prior_map: SegmentMap, title: str) -> None:
    """Print a table of a map's contents."""
    table(title, ("", ""), prior_map.info().rows())
