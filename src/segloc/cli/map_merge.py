"""``segloc map merge``"""

from __future__ import annotations

from functools import reduce
from pathlib import Path
from typing import Annotated

import typer

from .options import MapOut


def merge(
    maps: Annotated[list[Path], typer.Argument(metavar="MAP MAP...", help="Two or more maps.")],
    out: MapOut,
) -> None:
    """Merge maps of one place that share their frame; what they have in common is kept once."""
    from ..errors import ConfigError
    from ..files import checked_target
    from ..map.segment_map import SegmentMap
    from .map_info import show

    if len(maps) < 2:
        raise ConfigError("merging needs two maps or more")
    checked_target(out)
    prior_map = reduce(SegmentMap.merge, map(SegmentMap.load, maps))
    prior_map.save(out)
    show(prior_map, str(out))
