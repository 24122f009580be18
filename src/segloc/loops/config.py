"""Configuration of session alignment."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from ..system.section import Section
from ..types import Float64


class AlignConfig(Section):
    """Settings of the alignment of sessions."""

    every_m: float = Field(6.0, gt=0, description="distance between submaps, metres of travel")
    submap_m: float = Field(16.0, ge=0, description="travel that a submap's cloud for ICP spans")
    part_m: float = Field(
        200.0, gt=0, description="length of the parts in which submaps are localized, metres"
    )
    min_travel_m: float = Field(
        60.0, ge=0, description="minimum travel to a searched part of the same session, metres"
    )
    searched_parts: int = Field(
        4, ge=1, description="number of parts in which a submap is localized, by its votes"
    )
    # Registration of two submaps.
    icp_voxel: float = Field(0.4, gt=0)
    icp_max_correspondence: float = Field(1.5, gt=0, description="longest correspondence, metres")
    icp_radius: float = Field(35.0, gt=0, description="range of a submap used in ICP, metres")
    near_m: float = Field(0.5, gt=0, description="maximum distance of overlapping points, metres")
    min_shared: float = Field(
        0.5, gt=0, le=1, description="minimum overlap of two submaps, as a share of points"
    )
    max_shift_m: float = Field(3.0, gt=0, description="maximum correction by ICP, metres")
    # Agreement of loops.
    support_m: float = Field(80.0, gt=0, description="travel within which loops must agree, metres")
    min_support: int = Field(2, ge=1, description="minimum number of other loops that agree")
    agree_m: float = Field(1.0, gt=0, description="tolerance of agreement, plus drift, metres")
    agree_deg: float = Field(2.0, gt=0)
    drift: float = Field(
        0.03, ge=0, description="maximum drift of odometry, as a share of the distance travelled"
    )
    drift_deg: float = Field(0.02, ge=0, description="maximum drift of rotation, degrees per metre")
    # Weights of the graph.
    odometry_m: float = Field(0.02, gt=0, description="error of odometry after 1 m; grows as √")
    odometry_deg: float = Field(0.05, gt=0, description="error of rotation after 1 m, degrees")
    odometry_scale: float = Field(
        0.01, ge=0, description="systematic error, as a share of the distance travelled"
    )
    loop_m: float = Field(0.1, gt=0, description="minimum error of a loop, metres")
    loop_deg: float = Field(0.2, gt=0)
    # The second pass.
    dense_m: float = Field(10.0, ge=0, description="maximum distance of submaps of two passes")
    dense_passes: int = Field(
        8, ge=1, description="number of passes each submap is aligned to, the nearest first"
    )
    dense_rounds: int = Field(2, ge=0, description="number of dense passes")

    def least_covariance(self) -> Float64:
        """Return the smallest (6, 6) covariance of a loop, of rotation and translation."""
        return np.diag(np.repeat([np.radians(self.loop_deg), self.loop_m], 3) ** 2)
