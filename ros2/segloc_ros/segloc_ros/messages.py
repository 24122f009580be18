"""Between ROS's messages and the core's values."""

from __future__ import annotations

import array
import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseArray,
    PoseWithCovarianceStamped,
    TransformStamped,
)
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import Marker, MarkerArray

from .core.clicks import Click
from .core.diagnosis import Diagnosis, RobotState
from .core.frames import Transform, frame_name, pose_of, position_and_quaternion
from .core.replies import CandidatesReply, MatchesReply, OdometryReply, PoseReply

_ODOMETRY_M, _ODOMETRY_DEG = 0.05, 0.5
"""Deviations of computed odometry, and of its velocities per second."""
_GREEN, _ORANGE = (0.1, 0.8, 0.2), (1.0, 0.55, 0.0)


def seconds(stamp: Time) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec


def time_of(stamp: float) -> Time:
    sec = math.floor(stamp)
    nanosec = round(1e9 * (stamp - sec))
    return Time(sec=sec + nanosec // 10**9, nanosec=nanosec % 10**9)


def pose_in(pose: Any) -> NDArray[np.float64]:
    """(4, 4) of a geometry_msgs/Pose."""
    p, q = pose.position, pose.orientation
    return pose_of((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def transform_in(message: TransformStamped) -> Transform:
    t, q = message.transform.translation, message.transform.rotation
    T = pose_of((t.x, t.y, t.z), (q.x, q.y, q.z, q.w))
    return Transform(
        seconds(message.header.stamp),
        frame_name(message.header.frame_id),
        frame_name(message.child_frame_id),
        T,
    )


def transform_out(transform: Transform) -> TransformStamped:
    message = TransformStamped(child_frame_id=transform.child)
    message.header.frame_id, message.header.stamp = transform.parent, time_of(transform.stamp)
    xyz, xyzw = position_and_quaternion(transform.T_parent_child)
    t, q = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z = xyz
    q.x, q.y, q.z, q.w = xyzw
    return message


def click_in(message: PoseWithCovarianceStamped) -> Click:
    covariance = np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)
    return Click(message.header.frame_id, pose_in(message.pose.pose), covariance)


def pose_out(reply: PoseReply) -> PoseWithCovarianceStamped:
    message = PoseWithCovarianceStamped()
    message.header.frame_id, message.header.stamp = reply.frame, time_of(reply.stamp)
    set_pose(message.pose.pose, reply.T_map_base)
    message.pose.covariance = reply.covariance.ravel().tolist()
    return message


def odometry_out(reply: OdometryReply) -> Odometry:
    transform = reply.transform
    message = Odometry(child_frame_id=transform.child)
    message.header.frame_id = transform.parent
    message.header.stamp = time_of(transform.stamp)
    set_pose(message.pose.pose, transform.T_parent_child)
    twist = message.twist.twist
    for vector, values in ((twist.linear, reply.linear), (twist.angular, reply.angular)):
        vector.x, vector.y, vector.z = values.tolist()
    # Of one step, since the drift of the pose grows with the way.
    deviations = np.repeat([_ODOMETRY_M, math.radians(_ODOMETRY_DEG)], 3)
    message.pose.covariance = np.diag(deviations**2).ravel().tolist()
    message.twist.covariance = np.diag(deviations**2).ravel().tolist()
    return message


def set_pose(pose: Any, T: NDArray[np.float64]) -> None:
    """Fill a geometry_msgs/Pose."""
    xyz, xyzw = position_and_quaternion(T)
    p, q = pose.position, pose.orientation
    p.x, p.y, p.z = xyz
    q.x, q.y, q.z, q.w = xyzw


def candidates_out(reply: CandidatesReply) -> PoseArray:
    message = PoseArray(poses=[Pose() for _ in reply.places])
    message.header.frame_id, message.header.stamp = reply.frame, time_of(reply.stamp)
    for pose, (T, _) in zip(message.poses, reply.places, strict=True):
        set_pose(pose, T)
    return message


def cloud_out(points: NDArray[np.float32], frame: str, stamp: Time) -> PointCloud2:
    message = PointCloud2(height=1, width=len(points), is_dense=True)
    message.header.frame_id, message.header.stamp = frame, stamp
    message.fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    message.point_step, message.row_step = 12, 12 * len(points)
    message.data = array.array("B", np.ascontiguousarray(points, dtype="<f4").tobytes())
    return message


def matches_out(reply: MatchesReply) -> MarkerArray:
    """Lines from the sensor to what it was matched with, and what that is."""
    lines = _marker(reply, 0, Marker.LINE_LIST, 0.05)
    spots = _marker(reply, 1, Marker.SPHERE_LIST, 0.8)
    eye = _point(reply.position)
    spots.points = [_point(each) for each in reply.centroids]
    lines.points = [end for spot in spots.points for end in (eye, spot)]
    return MarkerArray(markers=[lines, spots])


def _marker(reply: MatchesReply, number: int, kind: int, size: float) -> Marker:
    marker = Marker(ns="matches", id=number, type=kind)
    marker.action = Marker.ADD if len(reply.centroids) else Marker.DELETE
    marker.header.frame_id, marker.header.stamp = reply.frame, time_of(reply.stamp)
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = size
    marker.color.r, marker.color.g, marker.color.b = _GREEN if reply.accepted else _ORANGE
    marker.color.a = 0.9
    return marker


def _point(xyz: NDArray[np.float64]) -> Point:
    x, y, z = (float(value) for value in xyz)
    return Point(x=x, y=y, z=z)


def state_out(state: RobotState, frame: str, message: Any) -> Any:
    """Fill a segloc_msgs/State."""
    message.header.frame_id, message.header.stamp = frame, time_of(state.stamp)
    message.status, message.map_to_odom = int(state.status), int(state.map_to_odom)
    message.localized, message.at_rest = state.localized, state.at_rest
    message.reason, message.map_url = state.reason, state.map_url
    message.confidence = state.confidence
    return message


def diagnostics_out(told: Diagnosis, name: str, stamp: Time) -> DiagnosticArray:
    status = DiagnosticStatus(level=bytes([told.level]), name=name, message=told.message)
    status.hardware_id = "segloc"
    status.values = [KeyValue(key=key, value=value) for key, value in told.values.items()]
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
