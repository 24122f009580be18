"""The newest transforms of tf: mounts, and whether they are fixed; odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from segloc import SeglocError, geometry
from segloc.robot import Pose, checked_pose, interpolated

from .frames import Transform, frame_name

_Place = Callable[[str], Pose | None]

_DEEPEST = 64
_MOST_KEPT = 4096
_STILL_M, _STILL_DEG = 0.01, 0.2
"""Limits of a joint's motion if it counts as fixed."""
_DRIVEN_M, _DRIVEN_DEG = 1.0, 30.0
"""Motion of the robot during which a joint has to stay still."""


class Fixity(Enum):
    """Whether a transform is a fixed mount."""

    FIXED = "fixed"
    MISSING = "no transform"
    UNPROVEN = "transform not known to be fixed"
    MOVING = "moving transform"


@dataclass(frozen=True)
class Mount:
    """T_target_source between two frames; None, and the fault, unless it is fixed."""

    fixity: Fixity
    T: Pose | None = None
    fault: str = ""


@dataclass
class _Joint:
    """A transform of /tf under watch: fixed once the robot has moved without it."""

    T: Pose
    T_odom_body: Pose | None  # when it began to stand still
    driven_s: float = math.inf  # stamp at which the robot had moved since
    is_fixed: bool = False
    moved: str = ""  # by how much, if it did

    def drive(self, stamp: float, T_odom_body: Pose) -> None:
        """Take a pose of the odometry."""
        if self.T_odom_body is None:
            self.T_odom_body = T_odom_body
        elif _steps(self.T_odom_body, T_odom_body, _DRIVEN_M, _DRIVEN_DEG):
            self.driven_s = min(self.driven_s, stamp)

    def restart(self, T_odom_body: Pose | None) -> None:
        """Wait for the robot's motion again."""
        self.T_odom_body, self.driven_s = T_odom_body, math.inf

    def update(self, stamp: float, T: Pose, T_odom_body: Pose | None) -> bool:
        """Take the joint's newest transform; return whether its fixity has changed."""
        if step := _steps(self.T, T, _STILL_M, _STILL_DEG):
            is_news = not self.moved
            self.T, self.moved, self.is_fixed = T, step, False
            self.restart(T_odom_body)
            return is_news
        if self.is_fixed or stamp < self.driven_s:
            return False
        self.is_fixed, self.moved = True, ""
        return True


def _steps(T_a: Pose, T_b: Pose, metres: float, degrees: float) -> str:
    """Describe the step between two poses if it exceeds a limit; "" if it does not."""
    step = geometry.inverse(T_a) @ T_b
    length = float(np.linalg.norm(step[:3, 3]))
    angle = math.degrees(geometry.rotation_angle(step))
    if length > metres:
        return f"{length:.2f} m"
    return f"{angle:.1f} degrees" if angle > degrees else ""


class TransformTree:
    """Frames in their parents, static ones and those that move.

    A mount is fixed if every transform of its chain is on /tf_static, or has stayed within 1 cm
    and 0.2 degrees while the robot moved.

    Parameters
    ----------
    keep_s : float
        Time for which moving transforms are kept [s].
    clock_jump_s : float
        Stamps that go back by less are late, by more of another clock [s].

    Attributes
    ----------
    changes : int
        Rises when the fixity, the parent or the static transform of a frame changes.
    """

    def __init__(self, keep_s: float = 10.0, clock_jump_s: float = 1.0) -> None:
        self.changes = 0
        self._keep_s, self._clock_jump_s = keep_s, clock_jump_s
        self._parents: dict[str, str] = {}
        self._static: dict[str, Pose] = {}
        self._moving: dict[str, deque[tuple[float, Pose]]] = {}
        self._joints: dict[str, _Joint] = {}  # those of /tf that a mount was looked up over
        self._T_odom_body: Pose | None = None

    def add(self, transforms: Iterable[Transform], static: bool) -> None:
        """Take in a message; transforms that are not rigid are ignored."""
        for each in transforms:
            parent, child = frame_name(each.parent), frame_name(each.child)
            if not parent or not child or parent == child or not math.isfinite(each.stamp):
                continue
            try:
                T = checked_pose(each.T_parent_child, "tf")
            except SeglocError:
                continue
            if self._parents.get(child) != parent:
                self._forget(child)
            self._parents[child] = parent
            self._add(child, each.stamp, T, static)

    def drive(self, stamp: float, T_odom_body: Pose) -> None:
        """Take a pose of the odometry, of any body of the robot: mounts are proven by motion."""
        self._T_odom_body = T_odom_body
        for joint in self._joints.values():
            if not joint.is_fixed:
                joint.drive(stamp, T_odom_body)

    def _forget(self, child: str) -> None:
        for known in (self._static, self._moving, self._joints):
            known.pop(child, None)
        self.changes += 1

    def _add(self, child: str, stamp: float, T: Pose, static: bool) -> None:
        if static:
            before = self._static.get(child)
            self.changes += before is None or not np.array_equal(before, T)
            self._static[child] = T
            self._moving.pop(child, None)
            self._joints.pop(child, None)
            return
        if child in self._static:
            return
        kept = self._moving.setdefault(child, deque(maxlen=_MOST_KEPT))
        joint = self._joints.get(child)
        if kept and stamp <= kept[-1][0]:
            if kept[-1][0] - stamp <= self._clock_jump_s:
                return  # late or repeated
            kept.clear()  # another clock
            if joint is not None:
                joint.restart(None)
        kept.append((stamp, T))
        while kept[0][0] < stamp - self._keep_s:
            kept.popleft()
        if joint is not None:
            self.changes += joint.update(stamp, T, self._T_odom_body)

    def mount(self, target: str, source: str) -> Mount:
        """Return T_target_source if it is fixed, or why it is not."""
        named = f"the transform {target} -> {source}"
        ways = self._ways(target, source)
        if ways is None:
            return Mount(Fixity.MISSING, fault=f"no transform {target} -> {source} in tf")
        joints = {frame: self._watched(frame) for frame in ways[0] + ways[1]}
        for frame, joint in joints.items():
            if joint is not None and joint.moved:
                by = f"{self._parents[frame]} -> {frame} by {joint.moved}"
                return Mount(Fixity.MOVING, fault=f"{named} moves ({by})")
        if any(joint is not None and not joint.is_fixed for joint in joints.values()):
            fault = f"{named} is on /tf, so it may move: unknown until the robot drives 1 m"
            return Mount(Fixity.UNPROVEN, fault=fault)
        T = self._between(target, source, self._held)
        assert T is not None
        return Mount(Fixity.FIXED, geometry.orthonormal(T))

    def _watched(self, frame: str) -> _Joint | None:
        """Return the joint of a frame, watched from now on; None if it is static."""
        if frame in self._static:
            return None
        if frame not in self._joints:
            kept = self._moving[frame]
            joint = self._joints[frame] = _Joint(kept[0][1], None)
            for stamp, T in kept:
                joint.update(stamp, T, None)
            joint.restart(self._T_odom_body)
        return self._joints[frame]

    def _held(self, frame: str) -> Pose | None:
        return self._static[frame] if frame in self._static else self._joints[frame].T

    def is_above(self, frame: str, odom: str, base: str) -> bool:
        """Return whether a frame is the odometry's, or hangs above it over the robot."""
        chain = self._chain(base)
        return odom in chain and frame_name(frame) in chain[chain.index(odom) :]

    def newest(self, target: str, source: str) -> float | None:
        """Return the newest stamp of T_target_source; None if it is unknown or static."""
        up, down = self._ways(target, source) or ([], [])
        moving = [self._moving.get(frame) for frame in up + down]
        stamps = [kept[-1][0] for kept in moving if kept]
        return min(stamps, default=None)

    def at(self, target: str, source: str, stamp: float) -> Pose | None:
        """Return T_target_source, (4, 4), interpolated at a time; None if it is not known then."""
        return self._between(target, source, lambda frame: self._interpolated(frame, stamp))

    def _interpolated(self, frame: str, stamp: float) -> Pose | None:
        if frame in self._static:
            return self._static[frame]
        kept = self._moving.get(frame)
        if not kept:
            return None
        if kept[-1][0] == stamp:
            return kept[-1][1]
        later = list[tuple[float, Pose]]()
        for entry in reversed(kept):  # most stamps are near the newest
            later.append(entry)
            if entry[0] <= stamp:
                break
        stamps, poses = zip(*later[:-3:-1], strict=True)
        T = interpolated(np.array(stamps), np.stack(poses), [stamp])[0]
        return T if np.isfinite(T).all() else None

    def _chain(self, frame: str) -> list[str]:
        """Return a frame and its ancestors."""
        chain = [frame]
        while chain[-1] in self._parents and len(chain) <= _DEEPEST:
            chain.append(self._parents[chain[-1]])
        return chain

    def _ways(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """Return the frames from source and from target up to their common ancestor, without it;
        None if they have none."""
        up, down = self._chain(frame_name(source)), self._chain(frame_name(target))
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        return up[: up.index(common)], down[: down.index(common)]

    def _between(self, target: str, source: str, place: _Place) -> Pose | None:
        ways = self._ways(target, source)
        if ways is None:
            return None
        ends = []
        for way in ways:
            T = np.eye(4)
            for frame in way:
                step = place(frame)
                if step is None:
                    return None
                T = step @ T
            ends.append(T)
        T_common_source, T_common_target = ends
        return geometry.inverse(T_common_target) @ T_common_source
