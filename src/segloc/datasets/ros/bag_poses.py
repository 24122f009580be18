"""Where the sensor of a bag was: from nav_msgs/Odometry, or from tf."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import DatasetError
from ...motion import interpolated
from ...types import Float64
from ..tracks import LONGEST_GAP_S, Track, clean_track, quaternion_poses
from .bag_file import optional
from .bag_headers import seconds
from .bag_tf import Edges, chain, frame_name, fullest_topics, is_pose, mount, row

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_ODOMETRY = "nav_msgs/msg/Odometry"


class Tracks(NamedTuple):
    """What a bag has of poses.

    Attributes
    ----------
    sensor : Track or None
        Of the sensor.
    base : Track or None
        Of a body that nothing says where the sensor is on; where there is none of the sensor.
    remarks : list of str
        On poses that are there and cannot be used as they are.
    """

    sensor: Track | None
    base: Track | None
    remarks: list[str]


def find_tracks(reader: AnyReader, edges: Edges, frame: str) -> Tracks:
    """The track of a frame.

    The odometry with the most messages whose body the sensor's place on is known, and else the
    way from the frame up to the root of tf, if anything moves on it.

    Parameters
    ----------
    reader : AnyReader
        Open.
    edges : Edges
        What tf says.
    frame : str
        The sensor's.
    """
    remarks: list[str] = []
    base: Track | None = None
    for topic in fullest_topics(reader, _ODOMETRY):
        with optional(topic, remarks):
            stamps, poses, body = _read_odometry(reader, topic)
            T_body_sensor = mount(edges, body, frame)
            if T_body_sensor is not None:
                return Tracks(clean_track(topic, stamps, poses @ T_body_sensor), None, remarks)
            base = base or clean_track(topic, stamps, poses)
            remarks.append(
                f"no transform {body} -> {frame} in the bag, so {topic} is not used: record "
                "/tf_static, or set local_cloud.mount"
            )
    track: Track | None = None
    with optional("tf", remarks):
        track = _tf_track(edges, frame)
    return Tracks(track, base if track is None else None, remarks)


def _read_odometry(reader: AnyReader, topic: str) -> tuple[Float64, Float64, str]:
    """Stamps (K,), poses (K, 4, 4), NaN for those that are no pose, and the frame they are of."""
    stamps, rows, bodies = [], [], set()
    wanted = [item for item in reader.connections if item.topic == topic]
    for item, logged, data in reader.messages(wanted):
        message: Any = reader.deserialize(data, item.msgtype)
        stamps.append(seconds(message.header.stamp) or logged * 1e-9)
        pose = message.pose.pose
        rows.append(row(pose.position, pose.orientation))
        bodies.add(frame_name(message.child_frame_id))
    if len(bodies) > 1:
        raise DatasetError(f"{topic}: poses of several frames: {', '.join(sorted(bodies))}")
    values = np.array(rows)
    good = np.array([is_pose(each) for each in rows], dtype=bool)
    poses = np.full((len(rows), 4, 4), np.nan)
    poses[good] = quaternion_poses(values[good, :3], values[good, 3:], topic)
    return np.array(stamps), poses, bodies.pop()


def _tf_track(edges: Edges, frame: str) -> Track | None:
    way = chain(edges, frame) or []
    moving = [edge for edge in way if not edge.static and len(edge.stamps) > 1]
    if not moving:
        return None
    finest = max(moving, key=lambda edge: len(edge.stamps))
    stamps, _ = finest.poses()
    T = np.tile(np.eye(4), (len(stamps), 1, 1))
    for edge in way:
        times, poses = edge.poses()
        if edge.static or len(times) == 1:
            T = poses[-1] @ T
        else:
            T = interpolated(times, poses, stamps, LONGEST_GAP_S) @ T
    return clean_track(f"tf, {way[-1].parent} to {frame}", stamps, T)
