"""How a sensor is mounted on its robot or vehicle."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from ..system.checks import Float64, Pose, checked_pose
from ..system.section import Section

Metres = Annotated[float, Field(ge=-1000, le=1000)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Row = tuple[float, float, float, float]


class MountConfig(Section):
    """Pose of the sensor on its base, a frame whose z axis is vertical on level ground.

    Given by position and angles, or by a matrix. It belongs to the robot that made a recording, so
    queries do not take it from the map.
    """

    xyz_m: tuple[Metres, Metres, Metres] | None = Field(
        None, description="position of the sensor on its base, metres"
    )
    rpy_deg: tuple[Degrees, Degrees, Degrees] | None = Field(
        None, description="roll, pitch, yaw on the base, Rz(yaw) Ry(pitch) Rx(roll), degrees"
    )
    matrix: tuple[Row, Row, Row, Row] | None = Field(
        None, description="T_base_sensor, 4 x 4, in place of both"
    )
    poses_of_base: bool = Field(False, description="pose files hold the base, not the sensor")

    @model_validator(mode="after")
    def _check(self) -> MountConfig:
        if self.matrix is not None:
            if self.xyz_m is not None or self.rpy_deg is not None:
                raise ValueError("matrix replaces xyz_m and rpy_deg: leave them out")
            checked_pose(self.matrix, "matrix")
        if self.poses_of_base and self.T_base_sensor is None:
            raise ValueError("poses_of_base needs xyz_m, rpy_deg or matrix")
        return self

    @property
    def T_base_sensor(self) -> Pose | None:
        """The (4, 4) transform; None if none is configured."""
        if self.matrix is not None:
            return checked_pose(self.matrix, "matrix")
        if self.xyz_m is None and self.rpy_deg is None:
            return None
        T = np.eye(4)
        T[:3, :3] = rotation(*(self.rpy_deg or (0.0, 0.0, 0.0)))
        T[:3, 3] = self.xyz_m or (0.0, 0.0, 0.0)
        return T


def rotation(roll: float, pitch: float, yaw: float) -> Float64:
    """Return Rz(yaw) Ry(pitch) Rx(roll) of angles in degrees, (3, 3) float64."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle), math.sin(angle)) for angle in map(math.radians, (roll, pitch, yaw))
    )
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
