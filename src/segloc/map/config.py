"""What a map is built of."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section
from .compact import CompactConfig

SMALL_CLOUD_VOXEL_M = 0.4
"""Of the cloud of a map that shall be small."""


class ViewConfig(Section):
    """One length of local cloud that a map is built from."""

    length_m: float = Field(
        ge=0, le=10_000, description="travelled distance a view spans; 0: single scans"
    )
    every_m: float = Field(ge=0.05, le=10_000, description="distance between views")


class MappingConfig(Section):
    """What a map keeps: views of several lengths, since short ones match single scans best."""

    views: tuple[ViewConfig, ...] = Field(
        (
            ViewConfig(length_m=40, every_m=8),
            ViewConfig(length_m=16, every_m=8),
        ),
        description="local clouds that segments are cut from, metres",
    )
    cloud_voxel: float = Field(
        0.3, ge=0.01, le=10, description="voxel of the cloud kept for verification, metres"
    )
    level: bool = Field(
        False, description="turn the poses about the first so that z is up, by walls in the scans"
    )
    compact: CompactConfig = CompactConfig()

    def smallest(self) -> MappingConfig:
        """The same for a map that shall take as little room as it can."""
        compact = CompactConfig(bits=4, max_views=1, cloud_bits=0, cloud_range_m=30.0)
        return self.model_copy(update={"compact": compact, "cloud_voxel": SMALL_CLOUD_VOXEL_M})
