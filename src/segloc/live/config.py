"""Configuration of online localization."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section
from ..tracker import TrackerConfig


class LiveConfig(Section):
    """When to query, what odometry may do, and how long to wait.

    Seconds are those of stamps, so that a stream gives the same states at any speed.
    """

    tracker: TrackerConfig = TrackerConfig(accumulate=True, every_m=10.0)
    every_s: float = Field(5.0, gt=0, description="maximum time between queries, seconds")
    every_lost_s: float = Field(1.0, gt=0, description="the same while lost or candidate, seconds")
    deadline_ms: float | None = Field(
        None, gt=0, description="time after which a query tries no more candidates, ms; null: none"
    )
    least_m: float = Field(
        0.05, ge=0, description="minimum standard deviation of a position, metres"
    )
    least_deg: float = Field(
        0.3, ge=0, description="minimum standard deviation of an angle, degrees"
    )

    odometry_s: float = Field(10.0, gt=0, description="history of odometry, seconds")
    height_s: float = Field(
        10.0, gt=0, description="time that an observed height counts for new places, seconds"
    )
    max_gap_s: float = Field(
        0.5, gt=0, description="maximum gap of odometry that is interpolated, seconds"
    )
    wait_s: float = Field(0.5, ge=0, description="maximum wait of a scan for odometry, seconds")
    waiting: int = Field(
        4, ge=1, description="maximum number of waiting scans, the first and the newest"
    )
    silent_s: float = Field(2.0, gt=0, description="time without scans until degraded, seconds")
    clock_jump_s: float = Field(
        1.0, gt=0, description="stamps going back by less are late, by more a new clock, seconds"
    )
    jump_m: float = Field(1.0, gt=0, description="minimum step of odometry that is a jump, metres")
    jump_deg: float = Field(30.0, gt=0, description="minimum turn that is a jump")
    max_speed_mps: float = Field(60.0, gt=0, description="maximum speed, metres per second")
    max_turn_dps: float = Field(360.0, gt=0, description="maximum turn rate, degrees per second")
