"""Configuration of verification."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section
from .nearby import NearbyConfig


class VerificationConfig(Section):
    """Verification of poses.

    The first two settings are for users. The model was fitted under the others: a localizer with
    other values has a note (:attr:`segloc.Localizer.notes`).
    """

    min_confidence: float = Field(
        0.99, ge=0, le=1, description="least probability of an accepted place"
    )
    refine: bool = Field(True, description="refine the pose by ICP")

    max_places: int = Field(8, ge=1, le=100, description="most promising places, which are aligned")
    coarse_radius: float = Field(
        0.5, ge=0.01, le=10, description="neighbourhood before ICP, metres"
    )
    overlap_radius: float = Field(
        0.3, ge=0.01, le=10, description="neighbourhood after ICP, metres"
    )
    overlap_sample: int = Field(
        2000, ge=1, le=10**6, description="most points of the query cloud in the overlap"
    )
    coarse_sample: int = Field(
        500, ge=1, le=10**6, description="most points of the query cloud in the ranking"
    )
    unmapped_overlap: float = Field(
        0.25,
        ge=0,
        le=1,
        description="score of a query point in unmapped space; chance",
    )
    icp_voxel: float = Field(
        0.8, ge=0.05, le=10, description="voxel size of clouds for ICP, metres"
    )
    icp_max_correspondence: float = Field(
        1.5, ge=0.05, le=50, description="maximum correspondence distance of ICP, metres"
    )
    icp_radius: float = Field(35.0, ge=1, le=1000, description="range of the points of ICP, metres")
    seen_radius: float = Field(
        0.4,
        ge=0.01,
        le=10,
        description="largest distance of a seen map point from a query point, metres",
    )
    visibility_range: float = Field(
        30.0, ge=1, le=200, description="range of the compared map points, metres"
    )
    visibility_bin: float = Field(
        2.0, ge=0.1, le=10, description="width of a pixel of the range image, degrees"
    )
    visibility_margin: float = Field(
        0.7,
        ge=0.01,
        le=100,
        description="distance behind a point from which a ray violates free space, metres",
    )
    visibility_sample: int = Field(3000, ge=1, le=10**6, description="most map points compared")
    flush_offset: float = Field(
        0.1, gt=0, description="largest distance of a point on a wall's surface, metres"
    )
    nearby: NearbyConfig = NearbyConfig()
