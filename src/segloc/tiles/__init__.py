"""Maps in tiles: overlapping squares in a folder or bucket, and localization in them.

A tile is a map by itself. It owns its square, and holds what a sensor sees from there.
``tiles.json`` lists the tiles; a thin map of all of them selects those to search. A
:class:`segloc.Localizer` accepts a :class:`TiledMap` as its map.
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
    from .cut import write_tile as write_tile
    from .index import INDEX as INDEX
    from .store import store_of as store_of
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "cut": "write_tile",
            "index": "INDEX",
            "store": "store_of",
        },
    )
