"""Poses, mount and gravity of a bag's sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import DatasetError
from ....motion import interpolated
from ....types import Float64, Int64, Pose
from ..gravity import GRAVITY_HALF_WINDOW_S, ORIENTATION_ERROR_DEG, Gravity, gravity_of
from ..recorded import Found
from ..tracks import LONGEST_GAP_S, Track, clean_track, quaternion_poses
from .bag_file import BagFile, faults_of, fullest_topics, messages_of, optional, seconds
from .bag_tf import Edges, chain, frame_name, is_pose, mount, mount_on_base, read_tf, row

if TYPE_CHECKING:
    from .rosbags_reader import BagReader

_ODOMETRY = "nav_msgs/msg/Odometry"


_WORLDS = frozenset({"map", "odom", "world", "earth", "camera_init"})
"""Usual names of frames that do not move with the robot (REP 105, LOAM)."""
_MIN_TRAVEL_M = 2.0  # of a body in a world's frame; joints and wheels move less


@dataclass(frozen=True)
class _Tracks:
    """Tracks of a frame: its own, else that of a body with unknown mount, or of one in it."""

    own: Track | None = None
    base: Track | None = None
    body: Track | None = None


def _find_tracks(reader: BagReader, edges: Edges, frame: str, remarks: list[str]) -> _Tracks:
    """Return the track of a frame, or else of a body on which its mount is unknown.

    Prefer the odometry with the most messages on whose body the frame is mounted; else the chain
    from the frame to the root of tf, if it moves. The frame of an odometry is that of a world.
    """
    base: Track | None = None
    for topic in fullest_topics(reader, _ODOMETRY):
        with optional(topic, remarks):
            stamps, poses, body, world = _read_odometry(reader, topic)
            if frame != body and frame in {world, *_WORLDS}:
                body_track = clean_track(topic, stamps, poses)
                return _Tracks(base=body_track, body=body_track)
            T_body_sensor = mount(edges, body, frame)
            if T_body_sensor is not None:
                return _Tracks(own=clean_track(topic, stamps, poses @ T_body_sensor))
            base = base or clean_track(topic, stamps, poses)
            remarks.append(
                f"no transform {body} -> {frame} in the bag, so {topic} is not used: record "
                "/tf_static, or set local_cloud.mount"
            )
    track: Track | None = None
    with optional("tf", remarks):
        track = _tf_track(edges, frame)
        if track is None and (inside := _body_in(edges, frame)) is not None:
            return _Tracks(base=base, body=inside)
    return _Tracks(track, base if track is None else None)


def _body_in(edges: Edges, frame: str) -> Track | None:
    """Return the track of the body that travels farthest in a frame, by tf."""
    tracks = [
        track
        for child in edges
        if chain(edges, child, frame) and (track := _tf_track(edges, child, frame)) is not None
    ]
    longest = max(tracks, key=_extent, default=None)
    return longest if longest is not None and _extent(longest) > _MIN_TRAVEL_M else None


def _extent(track: Track) -> float:
    return float(np.ptp(track.poses[:, :3, 3], axis=0).max())


def _read_odometry(reader: BagReader, topic: str) -> tuple[Float64, Float64, str, str]:
    """Return stamps (K,), poses (K, 4, 4), NaN where invalid, and the frames of body and world."""
    stamps, rows, bodies, world = [], [], set(), ""
    for message, logged in messages_of(reader, topic):
        stamps.append(seconds(message.header.stamp) or logged * 1e-9)
        pose = message.pose.pose
        rows.append(row(pose.position, pose.orientation))
        bodies.add(frame_name(message.child_frame_id))
        world = frame_name(message.header.frame_id)
    if len(bodies) > 1:
        raise DatasetError(f"{topic}: poses of several frames: {', '.join(sorted(bodies))}")
    values = np.array(rows)
    good = np.array([is_pose(each) for each in rows], dtype=bool)
    poses = np.full((len(rows), 4, 4), np.nan)
    poses[good] = quaternion_poses(values[good, :3], values[good, 3:], topic)
    return np.array(stamps), poses, bodies.pop(), world


def _tf_track(edges: Edges, frame: str, until: str | None = None) -> Track | None:
    edges_up = chain(edges, frame, until) or []
    moving = [edge for edge in edges_up if not edge.static and len(edge.stamps) > 1]
    if not moving:
        return None
    finest = max(moving, key=lambda edge: len(edge.stamps))
    stamps, _ = finest.poses()
    T = np.tile(np.eye(4), (len(stamps), 1, 1))
    for edge in edges_up:
        times, poses = edge.poses()
        if edge.static or len(times) == 1:
            T = poses[-1] @ T
        else:
            T = interpolated(times, poses, stamps, LONGEST_GAP_S) @ T
    return clean_track(f"tf, {edges_up[-1].parent} to {frame}", stamps, T)


_IMU = "sensor_msgs/msg/Imu"
_MAX_DELAY_S = 0.6  # between topics in recording
_MAX_MESSAGES = 8000  # around a scan: an IMU at 4 kHz
_MAX_DISAGREEMENT_DEG = 15.0  # between an orientation and accelerations
_MAX_TILT_DEG = 40.0  # off the expected vertical, if the IMU's mount is unknown


def _find_imu(reader: BagReader, edges: Edges, frame: str) -> tuple[str, Pose | None, str] | None:
    """Return topic, T_sensor_imu and a note: of an IMU with known mount, else of the fullest."""
    others: list[tuple[str, None, str]] = []
    for topic in fullest_topics(reader, _IMU):
        imu = _frame_of(reader, topic)
        T = mount(edges, frame, imu)
        if T is not None:
            return topic, T, ""
        note = f"{topic}: no transform {frame} -> {imu or 'IMU'} in the bag: assumed aligned"
        others.append((topic, None, note))
    return others[0] if others else None


def _frame_of(reader: BagReader, topic: str) -> str:
    message, _ = next(messages_of(reader, topic), (None, 0))
    return "" if message is None else frame_name(message.header.frame_id)


@dataclass(frozen=True)
class BagGravity:
    """Gravity at the scans of a bag; a ``GravitySource``."""

    file: BagFile
    name: str  # of the topic
    T_sensor_imu: Pose | None  # (4, 4); None if unknown
    note: str
    stamps: Float64  # (N,) of the scans [s]
    logged: Int64  # (N,) log times of the scans [ns]
    expected: Float64  # (3,) up in the sensor's frame while the robot stands level

    def at(self, k: int) -> Gravity | None:
        """Return gravity in the frame of the points of scan k."""
        with faults_of(self.file.path):
            accelerations, orientation = self._around(k)
        measured = gravity_of(accelerations)
        found = _gravity_of_orientation(orientation, accelerations) or measured
        if found is None:
            return None
        T = self.T_sensor_imu
        if T is not None:
            return Gravity(T[:3, :3] @ found.direction, found.error_deg)
        near = -found.direction @ self.expected > math.cos(math.radians(_MAX_TILT_DEG))
        return found if near else None

    def _around(self, k: int) -> tuple[Float64, Any]:
        """Return accelerations (K, 3), and the message closest to the scan in time."""
        reader = self.file.reader()
        stamp, logged = float(self.stamps[k]), int(self.logged[k])
        margin = round((GRAVITY_HALF_WINDOW_S + _MAX_DELAY_S) * 1e9)
        rows, nearest, nearest_s = [], None, GRAVITY_HALF_WINDOW_S
        around = messages_of(reader, self.name, logged - margin, logged + margin)
        for message, time in islice(around, _MAX_MESSAGES):
            off = abs((seconds(message.header.stamp) or time * 1e-9) - stamp)
            if off > GRAVITY_HALF_WINDOW_S:
                continue
            a = message.linear_acceleration
            rows.append([a.x, a.y, a.z])
            if off <= nearest_s:
                nearest, nearest_s = message, off
        return np.array(rows, np.float64).reshape(-1, 3), nearest


def _gravity_of_orientation(message: Any, accelerations: Float64) -> Gravity | None:
    """Return gravity from a known orientation that agrees with the accelerations."""
    if message is None:
        return None
    q, spread = message.orientation, np.asarray(message.orientation_covariance)
    values = np.array([q.x, q.y, q.z, q.w])
    with np.errstate(over="ignore", invalid="ignore"):
        unit = float(np.linalg.norm(values))
        mean = accelerations.mean(axis=0)
        length = float(np.linalg.norm(mean))
    known = np.isfinite(spread).all() and spread[0] > 0 and spread[4] > 0
    if not (known and abs(unit - 1.0) < 0.01 and 0.0 < length < math.inf):
        return None
    R = quaternion_poses(np.zeros((1, 3)), values[None], "orientation")[0, :3, :3]
    down: Float64 = -R[2]
    fits = -down @ mean / length > math.cos(math.radians(_MAX_DISAGREEMENT_DEG))
    return Gravity(down, ORIENTATION_ERROR_DEG) if fits else None


def place_scans(
    found: Found, reader: BagReader, paths: tuple[Path, ...], stamps: Float64, logged: Int64
) -> Found:
    """Return scans with the sensor's poses, mount and gravity, and remarks on unusable ones.

    Reads poses and tf; gravity is read around each scan on access.

    stamps, logged: (N,) of the scans: stamps [s] and log times [ns]
    """
    frame = found.frame
    edges, lost = read_tf(reader)
    remarks: list[str] = []
    tracks = _find_tracks(reader, edges, frame, remarks)
    T = mount_on_base(edges, frame)
    remarks += lost
    imu = None
    with optional("IMU", remarks):
        imu = _find_imu(reader, edges, frame)
    up = np.array([0.0, 0.0, 1.0]) if T is None else T[2, :3].copy()
    gravity = imu and BagGravity(BagFile(paths), *imu, stamps, logged, up)
    return replace(
        found,
        own_track=lambda: tracks.own,
        base_track=tracks.base,
        body_in_frame=tracks.body,
        T_base_sensor=T,
        gravity=gravity,
        notes=(*found.notes, *remarks),
    )
