"""The tf tree of a bag."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .... import geometry
from ....system.checks import MAX_METRES
from ....types import Float64, Pose
from ..tracks import are_unit, quaternion_poses, rising
from .bag_file import optional, seconds

if TYPE_CHECKING:
    from .rosbags_reader import BagReader

_TF = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
_BASES = frozenset({"base_link", "base_footprint", "base_frame", "base"})
"""Usual names of the frame of a robot's body, whose z axis is up (REP 103 and 105)."""
_MAX_DEPTH = 64


@dataclass
class Edge:
    """Transforms of a frame in its parent's."""

    parent: str
    stamps: list[float] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)
    static: bool = False

    def poses(self) -> tuple[Float64, Float64]:
        """Return stamps (K,), rising, and T_parent_child (K, 4, 4)."""
        stamps, rows = np.array(self.stamps), np.array(self.rows)
        order = np.argsort(stamps, kind="stable")
        order = order[rising(stamps[order])]
        poses = quaternion_poses(rows[order, :3], rows[order, 3:], f"tf of {self.parent}")
        return stamps[order], poses


Edges = dict[str, Edge]
"""Edges by child frame."""


def frame_name(frame: str) -> str:
    """Return a frame's name without the leading slash of old tf."""
    return frame.lstrip("/")


def read_tf(reader: BagReader) -> tuple[Edges, list[str]]:
    """Read the transforms of each frame, and remarks on dropped ones.

    Transforms that are not rigid are dropped, as is a second parent of a frame.
    """
    edges: Edges = {}
    lost: Counter[tuple[str, str]] = Counter()
    parents: dict[str, str] = {}
    remarks: list[str] = []
    for topic in sorted({item.topic for item in reader.connections if item.msgtype in _TF}):
        wanted = [c for c in reader.connections if c.topic == topic and c.msgtype in _TF]
        with optional(topic, remarks):
            for item, _, data in reader.messages(wanted):
                message: Any = reader.deserialize(data, item.msgtype)
                for entry in message.transforms:
                    _add(edges, entry, topic, lost, parents)
    remarks += [
        f"{topic}: {count} transforms of {child!r} dropped: no unit quaternion or not finite"
        for (topic, child), count in lost.items()
    ]
    remarks += [
        f"tf: {child!r} has two parents, {edges[child].parent!r} and {parent!r}: the second is "
        "ignored"
        for child, parent in parents.items()
    ]
    return edges, remarks


def _add(
    edges: Edges,
    entry: Any,
    topic: str,
    lost: Counter[tuple[str, str]],
    parents: dict[str, str],
) -> None:
    """Add one transform, or count it as invalid."""
    child, parent = frame_name(entry.child_frame_id), frame_name(entry.header.frame_id)
    values = row(entry.transform.translation, entry.transform.rotation)
    if not is_pose(values):
        lost[topic, child] += 1
        return
    edge = edges.setdefault(child, Edge(parent))
    if edge.parent != parent:
        parents.setdefault(child, parent)
        return
    edge.static |= topic.endswith("tf_static")
    edge.stamps.append(seconds(entry.header.stamp))
    edge.rows.append(values)


def is_pose(values: list[float]) -> bool:
    """Return whether a row of position and quaternion is a finite, plausible pose."""
    numbers = np.array([values])
    with np.errstate(all="ignore"):
        near = np.isfinite(numbers).all() and np.abs(numbers[0, :3]).max() <= MAX_METRES
    return bool(near and are_unit(numbers[:, 3:])[0])


def row(xyz: Any, q: Any) -> list[float]:
    """Return position and quaternion as one row."""
    return [xyz.x, xyz.y, xyz.z, q.x, q.y, q.z, q.w]


def chain(edges: Edges, frame: str, until: str | None = None) -> list[Edge] | None:
    """Return the edges from a frame up to another, or to the root; None if not connected."""
    found: list[Edge] = []
    while frame != until:
        if frame not in edges or len(found) > _MAX_DEPTH:
            return found if until is None and len(found) <= _MAX_DEPTH else None
        found.append(edges[frame])
        frame = edges[frame].parent
    return found


def mount(edges: Edges, body: str, frame: str) -> Pose | None:
    """Return T_body_frame if it is fixed in tf, else None.

    Both are chained to their common ancestor.
    """
    above = {body: 0} | {edge.parent: k for k, edge in enumerate(chain(edges, body) or [], 1)}
    upwards = [frame, *(edge.parent for edge in chain(edges, frame) or [])]
    common = next((name for name in upwards if name in above), None)
    if common is None:
        return None
    T_common_frame = _constant_product(chain(edges, frame, common) or [])
    T_common_body = _constant_product(chain(edges, body, common) or [])
    if T_common_frame is None or T_common_body is None:
        return None
    return geometry.inverse(T_common_body) @ T_common_frame


def mount_on_base(edges: Edges, frame: str) -> Pose | None:
    """Return T_base_frame on the body that carries a frame; None if tf has no fixed one."""
    for edge in chain(edges, frame) or []:
        if edge.parent.rpartition("/")[2] in _BASES:
            return mount(edges, edge.parent, frame)
    return None


def _constant_product(edges: list[Edge]) -> Pose | None:
    """Return the product of a chain's transforms if all are constant."""
    T = np.eye(4)
    for edge in edges:
        _, poses = edge.poses()
        if not edge.static and np.ptp(poses, axis=0).max() > 1e-6:
            return None
        T = poses[-1] @ T
    return T
