"""What a pose must show before it is believed."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section
from .nearby import NearbyConfig


class VerificationConfig(Section):
    """When a pose is believed.

    The first two are for users. The model was fitted under the others: a localizer whose
    configuration changes one says so (:attr:`segloc.Localizer.notes`).
    """

    min_confidence: float = Field(
        0.99, ge=0, le=1, description="probability from which a place is believed"
    )
    refine: bool = Field(True, description="refine the pose by ICP")

    max_refined: int = Field(
        2,
        ge=1,
        le=100,
        description="candidates that are measured: the best by segments, and the best by clouds",
    )
    refined_from: float = Field(
        0.9,
        ge=0,
        le=10,
        description="another pose is measured, too, whose rough overlap is this share of the best",
    )
    coarse_radius: float = Field(
        0.5, ge=0.01, le=10, description="neighbourhood before ICP, metres"
    )
    overlap_radius: float = Field(
        0.3, ge=0.01, le=10, description="neighbourhood after ICP, metres"
    )
    overlap_sample: int = Field(
        2000, ge=1, le=10**6, description="points of the query cloud that overlap is computed from"
    )
    coarse_sample: int = Field(
        500, ge=1, le=10**6, description="the same while candidates are ranked"
    )
    unmapped_overlap: float = Field(
        0.25,
        ge=0,
        le=1,
        description="a query point that lies where the map has nothing counts so much; chance",
    )
    icp_voxel: float = Field(
        0.8, ge=0.05, le=10, description="clouds are thinned to this for ICP, metres"
    )
    icp_max_correspondence: float = Field(
        1.5, ge=0.05, le=50, description="maximum correspondence distance of ICP, metres"
    )
    icp_radius: float = Field(
        35.0, ge=1, le=1000, description="points this near the sensor take part in ICP, metres"
    )
    seen_radius: float = Field(
        0.4, ge=0.01, le=10, description="a map point with a query point so near is seen, metres"
    )
    visibility_range: float = Field(
        30.0, ge=1, le=200, description="map points this near are judged, metres"
    )
    visibility_bin: float = Field(
        2.0, ge=0.1, le=10, description="width of a pixel of the range image, degrees"
    )
    visibility_margin: float = Field(
        0.7,
        ge=0.01,
        le=100,
        description="a ray violates free space that ends so far behind a point, metres",
    )
    visibility_sample: int = Field(
        3000, ge=1, le=10**6, description="map points that are judged at most"
    )
    flush_offset: float = Field(
        0.1, gt=0, le=10, description="a point that is off a wall by less is flush with it, metres"
    )
    nearby: NearbyConfig = NearbyConfig()
