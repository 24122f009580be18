"""How sessions are aligned: what is searched for, and what is believed."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section


class AlignConfig(Section):
    """Settings of the alignment of sessions."""

    every_m: float = Field(6.0, gt=0, description="travel between submaps: nodes of the graph")
    submap_m: float = Field(16.0, ge=0, description="travel that a submap's cloud spans for ICP")
    part_m: float = Field(
        200.0, gt=0, description="travel of the parts that sessions are searched in: little drift"
    )
    min_travel_m: float = Field(
        60.0, ge=0, description="parts of the same session nearer than this are not searched"
    )
    searched_parts: int = Field(
        4, ge=1, description="parts that a submap is searched in: those that most of it votes for"
    )
    # Registration of two submaps.
    icp_voxel: float = Field(0.4, gt=0)
    icp_max_correspondence: float = Field(1.5, gt=0, description="longest correspondence, metres")
    icp_radius: float = Field(35.0, gt=0, description="how far around a submap ICP looks, metres")
    near_m: float = Field(0.5, gt=0, description="points meet within this distance")
    min_shared: float = Field(
        0.5, gt=0, le=1, description="share of a submap's points that must meet the other's"
    )
    max_shift_m: float = Field(3.0, gt=0, description="larger corrections by ICP are not believed")
    # Agreement of loops.
    support_m: float = Field(80.0, gt=0, description="loops this close in travel must agree")
    min_support: int = Field(2, ge=1, description="others that must agree with a loop")
    agree_m: float = Field(1.0, gt=0, description="loops agree to this, plus the drift between")
    agree_deg: float = Field(2.0, gt=0)
    drift: float = Field(
        0.03, ge=0, description="largest drift believed, as a share of the distance travelled"
    )
    drift_deg: float = Field(0.02, ge=0, description="the same in degrees a metre")
    # Weights of the graph.
    odometry_m: float = Field(0.02, gt=0, description="error of odometry after a metre: grows as √")
    odometry_deg: float = Field(0.05, gt=0, description="the same of rotation")
    odometry_scale: float = Field(
        0.01, ge=0, description="error that grows with the distance travelled"
    )
    loop_m: float = Field(0.1, gt=0, description="least error of a loop, beside that of its ICP")
    loop_deg: float = Field(0.2, gt=0)
    # The second pass.
    dense_m: float = Field(10.0, ge=0, description="submaps of two passes this close are aligned")
    dense_passes: int = Field(
        8, ge=1, description="passes that a submap is aligned with, the nearest first"
    )
    dense_rounds: int = Field(2, ge=0, description="how many times that is done")
