"""Recordings made of others: the same scans, with poses of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from .errors import DatasetError
from .types import Float64, Int64, Recording, Scan

SourceT = TypeVar("SourceT", bound=Recording)


@dataclass(frozen=True)
class Derived(Generic[SourceT]):
    """A recording made of another's scans. Its poses are for the subclass to say."""

    source: SourceT

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
        """The scan at position i."""
        return self.source.scan(i)


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
