"""From the sweeps of a push-broom LiDAR to clouds in three dimensions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import geometry
from ..errors import ConfigError, DatasetError
from ..types import Float64, Int64, Recording, Scan, stamp_at
from .recorded import Selection


@dataclass(frozen=True)
class Swathes:
    """A recording whose scans are those of another, gathered over stretches of its way."""

    source: Recording  # with poses
    indices: Int64  # (S,) of the source's scans that give the swathes their poses
    poses: Float64  # (S, 4, 4) T_odom_sensor of those scans
    # (S, 4, 4) T_world_sensor of those scans where the source knows it, and else ``poses``
    truth: Float64
    # (S,) positions in the source: a swathe gathers from first up to last, without it
    first: Int64
    anchor: Int64
    last: Int64

    @property
    def name(self) -> str:
        return f"{self.source.name}-swathes"

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """The swathe at position i, in the frame of the scan in its middle.

        Raise DatasetError if there is no such position, or a scan cannot be read.
        """
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no swathe at position {i}, there are {len(self)}")
        poses = self.source.poses
        assert poses is not None  # seen to by swathes()
        T_anchor_odom = geometry.inverse(self.poses[i])
        clouds = [
            geometry.transform(T_anchor_odom @ poses[k], self.source.scan(k).points)
            for k in range(int(self.first[i]), int(self.last[i]))
        ]
        stamp = stamp_at(self, i)
        return Scan(np.concatenate(clouds), stamp=stamp, T_odom_sensor=self.poses[i])

    @property
    def stamps(self) -> Float64 | None:
        """Times of the scans in the middle of the swathes, (N,) float64 seconds, where known."""
        stamps = self.source.stamps
        return None if stamps is None else stamps[self.anchor]

    def select(self, selection: Selection) -> Swathes:
        """The swathes whose indices are in the selection, the same as they were."""
        mask = selection.mask(self.indices)
        names = ("indices", "poses", "truth", "first", "anchor", "last")
        return replace(self, **{name: getattr(self, name)[mask] for name in names})


def swathes(recording: Recording, length_m: float = 30.0) -> Swathes:
    """Gather a recording's scans into one cloud for every ``length_m`` of travel.

    A push-broom LiDAR sees one plane; the way makes the third dimension. 30 m are those of
    "Real-time LIDAR localization in natural and urban environments", Data Organization. Swathes
    follow each other without overlap; what is left over at the end is left out, and so are
    stretches without scans. Scans are taken to be de-skewed: all points in the frame of the pose.

    Raises
    ------
    ConfigError
        If the length is not positive.
    DatasetError
        If the recording has no poses, or its way is shorter than one swathe.
    """
    if not 0 < length_m < np.inf:
        raise ConfigError(f"length_m must be positive, not {length_m}")
    poses = recording.poses
    if poses is None:
        raise DatasetError(f"{recording.name}: swathes need the scans' poses")
    way = geometry.travelled(poses)
    cells = np.floor(way / length_m)  # scan by scan: a way may leap over more than there are scans
    if not len(way) or cells[-1] < 1:
        reach = way[-1] if len(way) else 0.0
        raise DatasetError(
            f"{recording.name}: a way of {reach:.1f} m is shorter than one swathe of {length_m:g} m"
        )
    bounds = np.flatnonzero(np.diff(cells, prepend=-1.0))
    first, last = bounds[:-1], bounds[1:]  # without the last stretch, which is not whole
    middle = length_m * (cells[first] + 0.5)
    anchor = np.minimum(np.searchsorted(way, middle), last - 1)
    truth = np.asarray(getattr(recording, "truth", poses))
    return Swathes(
        recording,
        recording.indices[anchor],
        poses[anchor],
        truth[anchor],
        first,
        anchor,
        last,
    )
