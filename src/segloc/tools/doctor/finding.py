"""A finding: one fault of a recording with its remedy, in one line."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ...frontend.local_cloud import Corner


class Fault(str, Enum):
    """Faults of recordings."""

    READING = "reading"
    UNUSABLE_POINTS = "unusable points"
    MISSING_RETURNS = "missing returns"
    MILLIMETRES = "millimetres"
    CENTIMETRES = "centimetres"
    FEET = "feet"
    MIRRORED = "mirrored"
    WORLD_COORDINATES = "world coordinates"
    CAMERA_AXES = "camera axes"
    Z_DOWN = "z down"
    TILT = "tilt"
    GRAVITY = "gravity"
    FEW_BEAMS = "few beams"
    ONLY_GROUND = "only ground"
    BODY_IN_VIEW = "body in view"
    NO_GROUND = "no ground"
    SINGLE_PLANE = "single plane"
    NO_POSES = "no poses"
    POSES_TILTED = "poses tilted"
    POSES_INVERSE = "poses inverse"
    POSES_WXYZ = "poses wxyz"
    POSES_OF_CAMERA = "poses of a camera"
    POSES_IN_MILLIMETRES = "poses in millimetres"
    POSES_SMEAR = "poses smear"
    POSES_OFF = "poses off"
    PASSES_APART = "passes apart"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class Finding:
    """One remark on a recording.

    Attributes
    ----------
    fault : Fault
    what : str
        What was measured.
    remedy : str
        "" if ``what`` includes it.
    wrong : bool
        True for a fault that prevents success, False for advice.
    box : pair of corners, optional
        Box of the faulty points, in the sensor's frame [m].
    scans : (int, int), optional
        Positions of two scans that disagree at their poses.
    """

    fault: Fault
    what: str
    remedy: str = ""
    wrong: bool = True
    box: tuple[Corner, Corner] | None = None
    scans: tuple[int, int] | None = None

    def __str__(self) -> str:
        return f"{self.what}: {self.remedy}" if self.remedy else self.what
