"""The prior map: segments, cloud, file, building and merging."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy

if TYPE_CHECKING:
    from .build import View as View
    from .build import add_view as add_view
    from .build import build_merged_map as build_merged_map
    from .build import empty_map as empty_map
    from .build import map_views as map_views
    from .compact import CompactConfig as CompactConfig
    from .compact import compacted as compacted
    from .config import DEFAULT_METHOD as DEFAULT_METHOD
    from .config import MappingConfig as MappingConfig
    from .from_cloud import ThinCloud as ThinCloud
    from .segment_map import concatenate_maps as concatenate_maps
    from .segment_map import with_sessions as with_sessions
    from .voxel_cloud import VoxelCloud as VoxelCloud
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "build": "View add_view build_merged_map empty_map map_views",
            "compact": "CompactConfig compacted",
            "config": "DEFAULT_METHOD MappingConfig",
            "from_cloud": "ThinCloud",
            "segment_map": "concatenate_maps with_sessions",
            "voxel_cloud": "VoxelCloud",
        },
    )
