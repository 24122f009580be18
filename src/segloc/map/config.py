"""What a map is built of."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ViewConfig(BaseModel):
    """One length of local cloud that a map is built from."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    length_m: float = Field(ge=0, description="travelled distance a view spans; 0: single scans")
    every_m: float = Field(gt=0, description="distance between views")


class MappingConfig(BaseModel):
    """What a map keeps: views of several lengths, since short ones match single scans best."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    views: tuple[ViewConfig, ...] = Field(
        (
            ViewConfig(length_m=40, every_m=8),
            ViewConfig(length_m=16, every_m=8),
        ),
        description="local clouds that segments are cut from, metres",
    )
    cloud_voxel: float = Field(0.3, gt=0, description="voxel of the cloud kept for verification")
