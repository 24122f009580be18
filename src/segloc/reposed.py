"""A recording with other poses than it came with."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import DatasetError
from .types import Float64, Int64, Recording, Scan


@dataclass(frozen=True)
class Reposed:
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

    source: Recording
    poses: Float64

    def __post_init__(self) -> None:
        if self.poses.shape != (len(self.source), 4, 4):
            raise DatasetError(
                f"{self.source.name}: poses of shape {self.poses.shape} for {len(self)} scans"
            )

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def indices(self) -> Int64:
        return self.source.indices

    @property
    def stamps(self) -> Float64 | None:
        return self.source.stamps

    def __len__(self) -> int:
        return len(self.source)

    def scan(self, i: int) -> Scan:
        """The scan at position i, with the pose it has here."""
        scan = self.source.scan(i)
        scan.T_odom_sensor = self.poses[i].copy()
        return scan
