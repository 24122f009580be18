"""Where the sensor of a bag was: from nav_msgs/Odometry, or from tf."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import geometry
from ...errors import DatasetError
from ...motion import interpolated
from ...types import Float64, Pose
from ..tracks import LONGEST_GAP_S, Track, clean_track, quaternion_poses, rising
from .bag_headers import seconds

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_ODOMETRY = "nav_msgs/msg/Odometry"
_TF = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
_DEEPEST = 64


@dataclass
class _Edge:
    """What tf says of a frame in its parent's."""

    parent: str
    stamps: list[float] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)
    static: bool = False

    def poses(self) -> tuple[Float64, Float64]:
        """Stamps (K,), rising, and T_parent_child (K, 4, 4)."""
        stamps, rows = np.array(self.stamps), np.array(self.rows)
        order = np.argsort(stamps, kind="stable")
        order = order[rising(stamps[order])]
        poses = quaternion_poses(rows[order, :3], rows[order, 3:], f"tf of {self.parent}")
        return stamps[order], poses


def find_track(reader: AnyReader, frame: str) -> tuple[Track | None, list[str]]:
    """The track of a frame, and remarks on poses that are there and cannot be used.

    The odometry with the most messages whose body the sensor's place on is known, and else the
    way from the frame up to the root of tf, if anything moves on it.

    Parameters
    ----------
    reader : AnyReader
        Open.
    frame : str
        The sensor's.
    """
    edges = _read_tf(reader)
    remarks: list[str] = []
    topics: dict[str, int] = {}
    for item in reader.connections:
        if item.msgtype == _ODOMETRY:
            topics[item.topic] = topics.get(item.topic, 0) + item.msgcount
    for topic in sorted(topics, key=lambda name: (-topics[name], name)):
        if not topics[topic]:
            continue
        stamps, poses, body = _read_odometry(reader, topic)
        T_body_sensor = _mount(edges, body, frame)
        if T_body_sensor is not None:
            return clean_track(topic, stamps, poses @ T_body_sensor), remarks
        remarks.append(
            f"{topic} has poses of {body!r}, and nothing says where {frame!r} is in it: not used"
        )
    return _tf_track(edges, frame), remarks


def _name(frame: str) -> str:
    return frame.lstrip("/")


def _read_odometry(reader: AnyReader, topic: str) -> tuple[Float64, Float64, str]:
    stamps, rows, bodies = [], [], set()
    wanted = [item for item in reader.connections if item.topic == topic]
    for item, logged, data in reader.messages(wanted):
        message: Any = reader.deserialize(data, item.msgtype)
        stamps.append(seconds(message.header.stamp) or logged * 1e-9)
        pose = message.pose.pose
        rows.append(_row(pose.position, pose.orientation))
        bodies.add(_name(message.child_frame_id))
    if len(bodies) > 1:
        raise DatasetError(f"{topic}: poses of several frames: {', '.join(sorted(bodies))}")
    values = np.array(rows)
    return np.array(stamps), quaternion_poses(values[:, :3], values[:, 3:], topic), bodies.pop()


def _read_tf(reader: AnyReader) -> dict[str, _Edge]:
    """What tf says of each frame, by its name."""
    edges: dict[str, _Edge] = {}
    wanted = [item for item in reader.connections if item.msgtype in _TF]
    if not wanted:
        return edges
    for item, _, data in reader.messages(wanted):
        message: Any = reader.deserialize(data, item.msgtype)
        for entry in message.transforms:
            child, parent = _name(entry.child_frame_id), _name(entry.header.frame_id)
            edge = edges.setdefault(child, _Edge(parent))
            if edge.parent != parent:
                raise DatasetError(
                    f"{item.topic}: {child} has two parents: {edge.parent}, {parent}"
                )
            edge.static |= item.topic.endswith("tf_static")
            edge.stamps.append(seconds(entry.header.stamp))
            edge.rows.append(_row(entry.transform.translation, entry.transform.rotation))
    return edges


def _row(xyz: Any, q: Any) -> list[float]:
    return [xyz.x, xyz.y, xyz.z, q.x, q.y, q.z, q.w]


def _chain(edges: dict[str, _Edge], frame: str, until: str | None = None) -> list[_Edge] | None:
    """The edges from a frame up to another, or to the root; None where there is no such way."""
    chain: list[_Edge] = []
    while frame != until:
        if frame not in edges or len(chain) > _DEEPEST:
            return chain if until is None and len(chain) <= _DEEPEST else None
        chain.append(edges[frame])
        frame = edges[frame].parent
    return chain


def _mount(edges: dict[str, _Edge], body: str, frame: str) -> Pose | None:
    """T_body_sensor, where tf says that it is fixed; None where it does not."""
    upwards = _chain(edges, frame, body)
    if upwards is not None:
        return _fixed(upwards)
    downwards = _chain(edges, body, frame)  # the body may be below the sensor
    T = None if downwards is None else _fixed(downwards)
    return None if T is None else geometry.inverse(T)


def _fixed(chain: list[_Edge]) -> Pose | None:
    """The product of a chain's transforms if none of them moves."""
    T = np.eye(4)
    for edge in chain:
        _, poses = edge.poses()
        if not edge.static and np.ptp(poses, axis=0).max() > 1e-6:
            return None
        T = poses[-1] @ T
    return T


def _tf_track(edges: dict[str, _Edge], frame: str) -> Track | None:
    chain = _chain(edges, frame) or []
    moving = [edge for edge in chain if not edge.static and len(edge.stamps) > 1]
    if not moving:
        return None
    finest = max(moving, key=lambda edge: len(edge.stamps))
    stamps, _ = finest.poses()
    T = np.tile(np.eye(4), (len(stamps), 1, 1))
    for edge in chain:
        times, poses = edge.poses()
        if edge.static or len(times) == 1:
            T = poses[-1] @ T
        else:
            T = interpolated(times, poses, stamps, LONGEST_GAP_S) @ T
    return clean_track(f"tf, {chain[-1].parent} to {frame}", stamps, T)
