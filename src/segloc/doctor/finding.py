"""A finding: one fault of a recording, in one line that names it and the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Fault(str, Enum):
    """What may be wrong with a recording."""

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
    FEW_BEAMS = "few beams"
    ONLY_GROUND = "only ground"
    NO_POSES = "no poses"
    POSES_TILTED = "poses tilted"
    POSES_INVERSE = "poses inverse"
    POSES_WXYZ = "poses wxyz"
    POSES_OF_CAMERA = "poses of a camera"
    POSES_IN_MILLIMETRES = "poses in millimetres"
    POSES_SMEAR = "poses smear"
    POSES_OFF = "poses off"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class Finding:
    """One thing that is worth saying of a recording."""

    fault: Fault
    what: str  # what was measured
    remedy: str = ""  # what mends it; "" where ``what`` says so
    # whether nothing can be expected to work before it is mended; otherwise it is advice
    wrong: bool = True

    def __str__(self) -> str:
        return f"{self.what}: {self.remedy}" if self.remedy else self.what
