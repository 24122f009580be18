"""Maps in tiles: overlapping squares in a folder or bucket, and localization in them.

A tile is a map by itself. It owns its square, and holds what a sensor sees from there.
``tiles.json`` lists the tiles; a thin map of all of them selects those to search. A
:class:`TiledLocalizer` is used like a :class:`segloc.Localizer`.
"""

from __future__ import annotations

from .change import merge_into_tiles, update_tiles
from .cut import cut_tiles
from .index import INDEX
from .localizer import TiledLocalizer, localizer_in, open_map
from .store import holds_tiles
from .tiled_map import TiledMap

__all__ = [
    "INDEX",
    "TiledLocalizer",
    "TiledMap",
    "cut_tiles",
    "holds_tiles",
    "localizer_in",
    "merge_into_tiles",
    "open_map",
    "update_tiles",
]
