"""All that a bag says of how its sensor stands: poses, its mounting, gravity."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...types import Float64, Int64, Pose
from ..gravity import GravitySource
from .bag_file import optional
from .bag_gravity import BagGravity, find_imu
from .bag_poses import Tracks, find_tracks
from .bag_tf import mount_on_base, read_tf

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


class Place(NamedTuple):
    """How a sensor stands.

    Attributes
    ----------
    tracks : Tracks
    T_base_sensor : (4, 4) float64 or None
        By tf, on a frame that is named as a robot's body.
    gravity : GravitySource or None
    """

    tracks: Tracks
    T_base_sensor: Pose | None
    gravity: GravitySource | None


def find_place(
    reader: AnyReader, paths: tuple[Path, ...], frame: str, stamps: Float64, logged: Int64
) -> Place:
    """Read poses and tf; gravity is read around each scan when it is asked for.

    Parameters
    ----------
    reader : AnyReader
        Open.
    paths : tuple of path
        Of the bag.
    frame : str
        Of the points.
    stamps, logged : (N,)
        Of the scans: seconds, and nanoseconds of recording.
    """
    edges, lost = read_tf(reader)
    tracks, T = find_tracks(reader, edges, frame), mount_on_base(edges, frame)
    tracks.remarks.extend(lost)
    imu = None
    with optional("IMU", tracks.remarks):
        imu = find_imu(reader, edges, frame)
    up = np.array([0.0, 0.0, 1.0]) if T is None else T[2, :3].copy()
    gravity = None if imu is None else BagGravity(paths, imu, stamps, logged, up)
    return Place(tracks, T, gravity)
