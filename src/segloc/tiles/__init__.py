"""Maps too large for one file: overlapping tiles in a folder or bucket, and localization in them.

A tile is a map by itself. It owns the square that it covers, and holds what a sensor sees from
there. ``tiles.json`` names the tiles; a thin map of all of them says which to look into. A
:class:`segloc.Localizer` takes a :class:`TiledMap` in place of a map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy
from .change import merge_into_tiles, update_tiles
from .cut import cut_tiles
from .store import holds_tiles
from .tiled_map import TiledMap

__all__ = ["TiledMap", "cut_tiles", "holds_tiles", "merge_into_tiles", "update_tiles"]

if TYPE_CHECKING:
    from .cut import written as written
    from .index import INDEX as INDEX
    from .store import store_of as store_of
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "cut": "written",
            "index": "INDEX",
            "store": "store_of",
        },
    )
