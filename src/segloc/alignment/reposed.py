"""A recording with other poses than it came with."""

from __future__ import annotations

from dataclasses import dataclass

from ..datasets import Derived
from ..errors import DatasetError
from ..types import Float64, Recording, Scan


@dataclass(frozen=True)
class Reposed(Derived[Recording]):
    """The scans of a recording with poses of one's own.

    Attributes
    ----------
    source : Recording
    poses : (N, 4, 4) float64

    Raises
    ------
    DatasetError
        If there are not as many poses as scans.
    """

    poses: Float64

    def __post_init__(self) -> None:
        if self.poses.shape != (len(self.source), 4, 4):
            raise DatasetError(
                f"{self.source.name}: poses of shape {self.poses.shape} for {len(self)} scans"
            )

    def scan(self, i: int) -> Scan:
        """The scan at position i, with the pose it has here."""
        scan = super().scan(i)
        scan.T_odom_sensor = self.poses[i].copy()
        return scan
