"""How poses are searched by occupancy."""

from __future__ import annotations

from pydantic import Field

from ...system.section import Section


class OccupancyConfig(Section):
    """The search for poses by occupancy."""

    enabled: bool = Field(
        True, description="where segments decide nothing, search by what stands where"
    )
    cell: float = Field(0.5, ge=0.1, le=5, description="edge of a cell, metres")
    reach_m: float = Field(
        20.0, ge=1, le=200, description="a sensor is searched for this near the mapped path"
    )
    range_m: float = Field(
        40.0, ge=5, le=100, description="what a query shows farther away is left out"
    )
    yaws: int = Field(120, ge=8, le=720, description="headings that are tried")
    columns: int = Field(400, ge=64, le=4096, description="occupied cells of a query at most")
    width: int = Field(4000, ge=16, le=10**6, description="windows that are divided at each level")
    work: int = Field(
        1_200_000,
        ge=1000,
        le=10**8,
        description="columns of the query times widest windows at most; bounds the time",
    )
    max_candidates: int = Field(48, ge=1, le=1000, description="candidates a storey")
