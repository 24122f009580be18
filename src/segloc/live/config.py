"""How a robot is followed."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section
from ..tracker import TrackerConfig

FOLLOWED = TrackerConfig(accumulate=True, every_m=10.0)


class LiveConfig(Section):
    """When queries are made, what odometry may do, and how long one waits for what.

    Seconds are those of stamps, so that the same stream gives the same states at any speed.
    """

    tracker: TrackerConfig = FOLLOWED
    every_s: float = Field(
        5.0, gt=0, description="a query is made after so long, however little was travelled"
    )
    every_lost_s: float = Field(1.0, gt=0, description="the same while lost or candidate")
    deadline_ms: float | None = Field(
        None, gt=0, description="a query tries no more candidates after it; none: all"
    )
    least_m: float = Field(
        0.05, ge=0, description="no position is claimed to be better known than this, metres"
    )
    least_deg: float = Field(0.3, ge=0, description="and no direction, degrees")

    odometry_s: float = Field(10.0, gt=0, description="odometry is kept for so long")
    max_gap_s: float = Field(
        0.5, gt=0, description="no pose is made up between odometry farther apart"
    )
    wait_s: float = Field(0.5, ge=0, description="a scan waits so long for its odometry")
    waiting: int = Field(4, ge=1, description="scans that wait at most; the newest win")
    silent_s: float = Field(2.0, gt=0, description="without scans for longer it is degraded")
    clock_jump_s: float = Field(
        1.0, gt=0, description="stamps that go back by less are late, by more another clock's"
    )
    jump_m: float = Field(1.0, gt=0, description="smaller steps of the odometry are no jumps")
    jump_deg: float = Field(30.0, gt=0, description="nor are smaller turns")
    max_speed_mps: float = Field(60.0, gt=0, description="nothing is as fast")
    max_turn_dps: float = Field(360.0, gt=0, description="or turns as fast, degrees a second")
