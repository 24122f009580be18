"""What tf has said lately: enough to find a mount, and to read odometry from it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from segloc import geometry
from segloc.errors import SeglocError
from segloc.motion import interpolated
from segloc.system.checks import checked_pose
from segloc.types import Pose

from .frames import Transform, frame_name

_Place = Callable[[str], Pose | None]

_DEEPEST = 64
_STILL = 1e-6
_MOST_KEPT = 4096


class TransformTree:
    """Frames in their parents, static ones and those that move.

    Parameters
    ----------
    keep_s : float
        What moves is kept for so long, seconds.

    Attributes
    ----------
    changes : int
        Grows whenever something static, or who hangs on whom, has changed.
    """

    def __init__(self, keep_s: float = 10.0) -> None:
        self.changes = 0
        self._keep_s = keep_s
        self._parents: dict[str, str] = {}
        self._static: dict[str, Pose] = {}
        self._moving: dict[str, deque[tuple[float, Pose]]] = {}

    def add(self, transforms: Iterable[Transform], static: bool) -> None:
        """Take in what a message says. What is no rigid transform is passed over."""
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

    def _forget(self, child: str) -> None:
        self._static.pop(child, None)
        self._moving.pop(child, None)
        self.changes += 1

    def _add(self, child: str, stamp: float, T: Pose, static: bool) -> None:
        if static:
            before = self._static.get(child)
            self.changes += before is None or not np.array_equal(before, T)
            self._static[child] = T
            self._moving.pop(child, None)
            return
        if child in self._static:
            return
        kept = self._moving.setdefault(child, deque(maxlen=_MOST_KEPT))
        if kept and stamp <= kept[-1][0]:
            if kept[-1][0] - stamp < self._keep_s:
                return  # late, or said twice
            kept.clear()  # another clock
        kept.append((stamp, T))
        while kept[0][0] < stamp - self._keep_s:
            kept.popleft()

    def mount(self, base: str, sensor: str) -> Pose | None:
        """T_base_sensor, (4, 4), if tf says that it is fixed.

        A joint that tf repeats without its ever moving counts as fixed.
        """
        T = self._between(base, sensor, self._fixed)
        return None if T is None else geometry.orthonormal(T)

    def newest(self, target: str, source: str) -> float | None:
        """The newest stamp at which T_target_source is known; None where it is not, or static."""
        up, down = self._ways(target, source) or ([], [])
        moving = [self._moving.get(frame) for frame in up + down]
        stamps = [kept[-1][0] for kept in moving if kept]
        return min(stamps, default=None)

    def at(self, target: str, source: str, stamp: float) -> Pose | None:
        """T_target_source, (4, 4), at a time between what was said; None where it is not known."""
        return self._between(target, source, lambda frame: self._interpolated(frame, stamp))

    def _interpolated(self, frame: str, stamp: float) -> Pose | None:
        if frame in self._static:
            return self._static[frame]
        kept = self._moving.get(frame)
        if not kept:
            return None
        if kept[-1][0] == stamp:
            return kept[-1][1]
        stamps, poses = zip(*kept, strict=True)
        T = interpolated(np.array(stamps), np.stack(poses), [stamp])[0]
        return T if np.isfinite(T).all() else None

    def _fixed(self, frame: str) -> Pose | None:
        if frame in self._static:
            return self._static[frame]
        kept = self._moving.get(frame)
        if not kept or np.ptp(np.stack([T for _, T in kept]), axis=0).max() > _STILL:
            return None
        return kept[-1][1]

    def _chain(self, frame: str) -> list[str]:
        """A frame and all above it."""
        chain = [frame]
        while chain[-1] in self._parents and len(chain) <= _DEEPEST:
            chain.append(self._parents[chain[-1]])
        return chain

    def _ways(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """The frames from source and from target up to the first above both, without it; None where
        there is none."""
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
