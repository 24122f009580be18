"""GNSS fixes of a recording: where an antenna was, as receivers say it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import DatasetError
from ..types import Float64


@dataclass(frozen=True)
class Fixes:
    """K fixes, in the order of time.

    Attributes
    ----------
    source : str
        The topic.
    stamps : (K,) float64
        Seconds, on the clock of the scans.
    degrees : (K, 3) float64
        Longitude, latitude (degrees) and height above the ellipsoid (m), WGS 84.
    error_m : (K,) float64
        Standard deviation along the worse horizontal axis; NaN where the receiver does not say.
    """

    source: str
    stamps: Float64
    degrees: Float64
    error_m: Float64

    def __len__(self) -> int:
        return len(self.stamps)


def read_fixes(path: str | Path, topic: str | None = None) -> Fixes:
    """The fixes of a bag: ``sensor_msgs/NavSatFix``, without those that say that there is none.

    Parameters
    ----------
    path : path
        A bag.
    topic : str, optional
        By default the one with the most messages.

    Raises
    ------
    DatasetError
        If it is no bag, or has no fixes.
    MissingDependency
        If the package rosbags is not installed.
    """
    from .ros import bag_fixes, bags

    paths = bags.bag_paths(Path(path))
    if not paths:
        raise DatasetError(f"{path}: no bag, so no GNSS fixes (sensor_msgs/NavSatFix)")
    source, rows = bag_fixes.rows_of(paths, topic)
    if not len(rows):
        raise DatasetError(f"{path}: {source}: no message with a fix")
    rows = rows[rows[:, 0].argsort(kind="stable")]
    return Fixes(source, rows[:, 0], rows[:, 1:4], rows[:, 4])
