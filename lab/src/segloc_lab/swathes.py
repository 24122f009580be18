"""Combine the sweeps of a push-broom LiDAR into 3D clouds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from segloc import geometry
from segloc.errors import ConfigError, DatasetError
from segloc.tools.datasets import Selection
from segloc.types import Float64, Int64, Recording, Scan, stamp_at


@dataclass(frozen=True)
class Swathes:
    """A recording that accumulates the scans of another over stretches of its trajectory."""

    source: Recording  # with poses
    indices: Int64  # (S,) of the source's scans that define the swathes' poses
    poses: Float64  # (S, 4, 4) T_odom_sensor of those scans
    truth: Float64  # (S, 4, 4) T_world_sensor of those scans if the source has it, else ``poses``
    # (S,) positions in the source: a swathe holds the scans from first to last, exclusive
    first: Int64
    anchor: Int64
    last: Int64

    @property
    def name(self) -> str:
        return f"{self.source.name}-swathes"

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """Return the swathe at position i, in the frame of its middle scan.

        Raise DatasetError if the position does not exist, or a scan cannot be read.
        """
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no swathe at position {i} of {len(self)}")
        poses = self.source.poses
        assert poses is not None  # checked by swathes()
        T_anchor_odom = geometry.inverse(self.poses[i])
        clouds = [
            geometry.transform(T_anchor_odom @ poses[k], self.source.scan(k).points)
            for k in range(int(self.first[i]), int(self.last[i]))
        ]
        stamp = stamp_at(self, i)
        return Scan(np.concatenate(clouds), stamp=stamp, T_odom_sensor=self.poses[i])

    @property
    def stamps(self) -> Float64 | None:
        """Stamps of the middle scans (N,) float64 [s], if known."""
        stamps = self.source.stamps
        return None if stamps is None else stamps[self.anchor]

    def select(self, selection: Selection) -> Swathes:
        """Return the swathes whose indices are selected."""
        mask = selection.mask(self.indices)
        names = ("indices", "poses", "truth", "first", "anchor", "last")
        return replace(self, **{name: getattr(self, name)[mask] for name in names})


def swathes(recording: Recording, length_m: float = 30.0) -> Swathes:
    """Accumulate a recording's scans into one cloud per ``length_m`` of travel.

    A push-broom LiDAR measures one plane; travel adds the third dimension. 30 m is the length in
    "Real-time LIDAR localization in natural and urban environments", Data Organization. Swathes
    do not overlap; an incomplete last swathe and stretches without scans are dropped. Scans must
    be de-skewed: all points in the frame of the pose.

    Raises
    ------
    ConfigError
        If the length is not positive.
    DatasetError
        If the recording has no poses, or is shorter than one swathe.
    """
    if not 0 < length_m < np.inf:
        raise ConfigError(f"length_m must be positive, not {length_m}")
    poses = recording.poses
    if poses is None:
        raise DatasetError(f"{recording.name}: swathes need the scans' poses")
    travelled = geometry.distance_travelled(poses)
    cells = np.floor(travelled / length_m)  # one per scan: poses may jump over many swathes
    if not len(travelled) or cells[-1] < 1:
        reach = travelled[-1] if len(travelled) else 0.0
        raise DatasetError(
            f"{recording.name}: {reach:.1f} m of travel, one swathe needs {length_m:g} m"
        )
    bounds = np.flatnonzero(np.diff(cells, prepend=-1.0))
    first, last = bounds[:-1], bounds[1:]  # without the incomplete last stretch
    middle = length_m * (cells[first] + 0.5)
    anchor = np.minimum(np.searchsorted(travelled, middle), last - 1)
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
