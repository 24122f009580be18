"""Maps too large for one file: overlapping tiles in a folder or bucket, and localization in them.

A tile is a map by itself. It owns the square that it covers, and holds what a sensor sees from
there. ``tiles.json`` names the tiles; a thin map of all of them says which to look into. A
:class:`segloc.Localizer` takes a :class:`TiledMap` in place of a map.
"""

from .change import merge_into_tiles, update_tiles
from .cut import cut_tiles
from .store import holds_tiles
from .tiled_map import TiledMap

__all__ = ["TiledMap", "cut_tiles", "holds_tiles", "merge_into_tiles", "update_tiles"]
