"""Compare the passes over a place: within a recording, and across recordings in one frame.

Neighbouring clouds agree in each pass, also where two passes are metres apart and double every
object. So clouds of two passes are compared at shifts of some metres about their poses, and the
best one is refined.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ... import _native, geometry
from ...errors import DatasetError
from ...frontend.local_cloud import LocalCloudConfig
from ...joining.same_place import MEET_HEIGHT_M, MEET_M
from ...joining.shift import MAX_SHIFT_M, MAX_TURN_DEG
from ...types import Float32, Float64, Int64, Pose, Recording
from .finding import Fault, Finding
from .pose_faults import ALIGN_M, ALIGNER, MIN_POINTS, most_turned_deg, standing

_MAX_OFF_M, _MAX_OFF_DEG = 1.5, 3.0
"""Offset above which passes of one recording are a problem: those of good GNSS agree to 1 m."""
_EVERY_M, _APART_M = 2.0, 20.0  # between stations; travel between two passes
_PASSES, _PAIRS, _MIN_PAIRS = 6, 5, 3  # longest pairs of passes, clouds compared of each
_SEARCH_M, _STEP_M, _TURNS_DEG = 3.5, 0.5, (-4.0, -2.0, 0.0, 2.0, 4.0)
_COARSE_M, _NEAR_M = 0.6, 0.4
_COARSE_POINTS, _POINTS = 500, 1500
_MIN_OVERLAP, _MIN_GAIN = 0.4, 0.1  # of the best fit; over the fit near the poses


@dataclass(frozen=True)
class Stations:
    """Poses some metres apart of several recordings.

    Attributes
    ----------
    session, scan : (N,) int64
        Recording, and position in it.
    travelled : (N,) float64
        Distance travelled in the recording [m].
    poses : (N, 4, 4) float64
    max_turn_deg : tuple of float
        Maximum turn between comparable scans of each recording.
    """

    session: Int64
    scan: Int64
    travelled: Float64
    poses: Float64
    max_turn_deg: tuple[float, ...]

    @classmethod
    def of(cls, recordings: Sequence[Recording], config: LocalCloudConfig) -> Stations:
        """Choose stations along recordings with poses."""
        sessions, scans, travels, poses = [], [], [], []
        for k, recording in enumerate(recordings):
            path = recording.poses
            assert path is not None
            travelled = geometry.distance_travelled(path)
            chosen = geometry.stations(travelled, _EVERY_M)
            sessions.append(np.full(len(chosen), k, dtype=np.int64))
            scans.append(chosen)
            travels.append(travelled[chosen])
            poses.append(path[chosen])
        return cls(
            np.concatenate(sessions),
            np.concatenate(scans),
            np.concatenate(travels),
            np.concatenate(poses),
            tuple(most_turned_deg(recording, config) for recording in recordings),
        )

    def pairs(self, *, own: bool) -> Int64:
        """Pair each station with the nearest one of an earlier pass (P, 2), by the later one.

        The earlier pass is of the same recording (``own``), or of an earlier one.
        """
        squeezed = self.poses[:, :3, 3] * [1.0, 1.0, MEET_M / MEET_HEIGHT_M]
        near = cKDTree(squeezed).query_pairs(MEET_M, output_type="ndarray")
        first, second = near.min(axis=1), near.max(axis=1)
        same = self.session[first] == self.session[second]
        apart = self.travelled[second] - self.travelled[first] > _APART_M
        kept = (same & apart if own else ~same) & self._share_view(first, second)
        first, second = first[kept], second[kept]
        distance = np.linalg.norm(squeezed[first] - squeezed[second], axis=1)
        order = np.lexsort((distance, second))
        _, nearest = np.unique(second[order], return_index=True)
        chosen = order[nearest]
        return np.column_stack([first[chosen], second[chosen]])

    def _share_view(self, first: Int64, second: Int64) -> NDArray[np.bool_]:
        headings = np.arctan2(self.poses[:, 1, 0], self.poses[:, 0, 0])
        turned = np.abs((headings[first] - headings[second] + np.pi) % (2 * np.pi) - np.pi)
        most = np.radians(np.array(self.max_turn_deg))
        least = np.minimum(most[self.session[first]], most[self.session[second]])
        return np.asarray(turned <= least)

    def passes(self, pairs: Int64) -> list[Int64]:
        """Split pairs where either pass is interrupted, and return the longest."""
        if not len(pairs):
            return []
        jump = np.abs(np.diff(self.travelled[pairs], axis=0)).max(axis=1) > _APART_M
        other = (np.diff(self.session[pairs], axis=0) != 0).any(axis=1)
        parts = np.split(pairs, np.flatnonzero(jump | other) + 1)
        return sorted(parts, key=len, reverse=True)[:_PASSES]


@dataclass(frozen=True)
class Offset:
    """Offset of a pass over a place against an earlier one.

    Attributes
    ----------
    off_m, turn_deg : float
        Medians of the clouds compared: horizontal, about the vertical.
    count : int
        Number of clouds compared.
    later, earlier : (int, int, int)
        Recording, and positions of the first and last scan.
    place : (2,) float64
        Middle of the pass, x and y [m].
    scans : (int, int)
        Positions of the two scans there, the earlier first.
    """

    off_m: float
    turn_deg: float
    count: int
    later: tuple[int, int, int]
    earlier: tuple[int, int, int]
    place: Float64
    scans: tuple[int, int]

    def exceeds(self, off_m: float, turn_deg: float) -> bool:
        """Return whether the offset is larger."""
        return self.off_m > off_m or self.turn_deg > turn_deg

    @property
    def size(self) -> float:
        """Offset for comparison [m]: a degree displaces the edge of a cloud by half a metre."""
        return max(self.off_m, 0.5 * self.turn_deg)


def offsets(
    recordings: Sequence[Recording], config: LocalCloudConfig | None = None, *, own: bool = True
) -> list[Offset]:
    """Measure passes over one place against each other, the largest offset first.

    Parameters
    ----------
    recordings : sequence of Recording
        With poses in one frame.
    config : LocalCloudConfig, optional
        Mount of the sensor.
    own : bool
        True for passes within each recording, False for those of two recordings.
    """
    if any(recording.poses is None or not len(recording) for recording in recordings):
        return []
    stations = Stations.of(recordings, config or LocalCloudConfig())

    @lru_cache(maxsize=4)
    def cloud(k: int) -> Float32:
        scan = recordings[int(stations.session[k])].scan(int(stations.scan[k]))
        return standing(scan.points)

    found = []
    for part in stations.passes(stations.pairs(own=own)):
        measured = []
        for first, second in part[geometry.spread(len(part), _PAIRS)]:
            with suppress(DatasetError):
                poses = stations.poses[first], stations.poses[second]
                off = _offset(cloud(int(first)), cloud(int(second)), *poses)
                measured += [] if off is None else [off]
        if len(measured) >= _MIN_PAIRS:
            off_m, turn_deg = np.median(measured, axis=0)
            earlier, later = (_extent(stations, column) for column in part.T)
            first, second = (int(k) for k in part[len(part) // 2])
            place = stations.poses[second, :2, 3]
            scans = int(stations.scan[first]), int(stations.scan[second])
            size = float(off_m), float(turn_deg), len(measured)
            found.append(Offset(*size, later, earlier, place, scans))
    return sorted(found, key=lambda each: -each.size)


def _extent(stations: Stations, rows: Int64) -> tuple[int, int, int]:
    scans = stations.scan[rows]
    return int(stations.session[rows[0]]), int(scans.min()), int(scans.max())


def revisit_findings(recording: Recording, config: LocalCloudConfig | None = None) -> list[Finding]:
    """Report the passes of a recording over one place that are farthest apart, if they are."""
    worst = next(iter(offsets([recording], config)), None)
    if worst is None or not worst.exceeds(MAX_SHIFT_M, MAX_TURN_DEG):
        return []
    wrong = worst.exceeds(_MAX_OFF_M, _MAX_OFF_DEG)
    return [_finding(worst, [recording], wrong)]


def session_findings(
    recordings: Sequence[Recording], config: LocalCloudConfig | None = None
) -> list[Finding]:
    """Report the recording that is farthest off an earlier one where they meet, if it is."""
    worst = next(iter(offsets(recordings, config, own=False)), None)
    if worst is None or not worst.exceeds(MAX_SHIFT_M, MAX_TURN_DEG):
        return []
    return [_finding(worst, recordings, True)]


def _finding(offset: Offset, recordings: Sequence[Recording], wrong: bool) -> Finding:
    later, earlier = (_scans(each, recordings) for each in (offset.later, offset.earlier))
    x, y = offset.place
    what = (
        f"{later} are {offset.off_m:.1f} m and {offset.turn_deg:.1f} degrees off {earlier} at the "
        f"same place, around x {x:.0f}, y {y:.0f} (median of {offset.count} clouds)"
    )
    remedy = "the map would show things twice there: `segloc align` joins the passes"
    return Finding(Fault.PASSES_APART, what, remedy, wrong, scans=offset.scans)


def _scans(extent: tuple[int, int, int], recordings: Sequence[Recording]) -> str:
    session, first, last = extent
    indices = recordings[session].indices
    text = f"scans {indices[first]} to {indices[last]}"
    return text if len(recordings) == 1 else f"{text} of {recordings[session].name}"


def _offset(
    target: Float32, source: Float32, T_world_target: Pose, T_world_source: Pose
) -> tuple[float, float] | None:
    """Return how far the source's pose is off [m, deg]; None if the clouds do not fit."""
    if min(len(target), len(source)) < MIN_POINTS or geometry.in_one_plane(target):
        return None
    T_target_world = geometry.inverse(T_world_target)
    T_as_is = T_target_world @ T_world_source
    shifted = T_target_world @ (_shifts(T_world_source[:3, 3]) @ T_world_source)
    index = _native.PointIndex(target, _COARSE_M)
    few = source[:: 1 + len(source) // _COARSE_POINTS].copy()
    best = shifted[int(index.overlap(few, shifted, _COARSE_M).argmax())]
    surfaces = ALIGNER.surface(target), ALIGNER.surface(source)
    aligned = [ALIGNER.align(*surfaces, T) for T in (T_as_is, best)]
    poses = np.stack([T_as_is if a is None else a.T_target_source for a in aligned])
    near = _native.PointIndex(target, _NEAR_M)
    overlaps = near.overlap(source[:: 1 + len(source) // _POINTS].copy(), poses, _NEAR_M)
    chosen = int(overlaps[1] > overlaps[0] + _MIN_GAIN)
    moved = T_world_target @ poses[chosen] @ geometry.inverse(T_world_source)
    off = geometry.transform(moved, T_world_source[None, :3, 3])[0] - T_world_source[:3, 3]
    off_m = float(np.hypot(off[0], off[1]))
    if overlaps[chosen] < _MIN_OVERLAP or off_m > _SEARCH_M + ALIGN_M:
        return None
    return off_m, abs(float(np.degrees(geometry.heading(moved))))


def _shifts(position: Float64) -> Float64:
    """Return shifts and turns about a position, (S, 4, 4)."""
    steps = np.arange(-_SEARCH_M, _SEARCH_M + _STEP_M / 2, _STEP_M)
    about = geometry.rigid(np.eye(3), position)
    turns = [
        about @ geometry.yaw_transform(np.radians(turn)) @ geometry.inverse(about)
        for turn in _TURNS_DEG
    ]
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    moves = np.tile(np.eye(4), (len(x), 1, 1))
    moves[:, 0, 3], moves[:, 1, 3] = x, y
    shifts: Float64 = np.concatenate([moves @ turn for turn in turns])
    return shifts
