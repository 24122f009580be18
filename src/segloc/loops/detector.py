"""Online loop detection for the pose graph of a SLAM back-end."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from .. import geometry
from ..config import Config
from ..descriptors import create
from ..frontend.local_cloud import odometry_pose
from ..frontend.rolling_cloud import RollingCloud
from ..frontend.segmentation import Segmenter
from ..localizer import Localizer
from ..map.build import empty_map
from ..map.segment_map import SegmentMap
from ..proposals.proposer import Query
from ..system.checks import checked_pose
from ..types import Float64, Pose, Scan
from .config import AlignConfig
from .consistency import reject_unsupported
from .loops import Chain, Loop, SubmapRegistration, loop_in_part, query_of
from .submaps import Submap, add_submap


class LoopConfig(AlignConfig):
    """Settings of online loop detection."""

    part_m: float = Field(80.0, gt=0, description="length of the searched parts, metres")
    min_support: int = Field(
        1, ge=0, description="number of other loops that must agree before a loop is returned"
    )
    reach_m: float = Field(
        25.0, gt=0, description="range within which parts are searched, plus drift, metres"
    )
    max_parts: int = Field(64, ge=1, description="number of parts kept, the newest")


@dataclass(frozen=True)
class LoopClosure:
    """Loop between two scans of one place.

    Attributes
    ----------
    i, j : int
        Scan numbers in order of adding, from 0; i < j.
    T_i_j : (4, 4) float64
        Takes points from the sensor's frame at scan j to that at scan i.
    covariance : (6, 6) float64
        Of a small rotation [rad], then a translation [m], both in the frame of j.
    confidence : float
        Posterior probability of the place, in [0, 1], before agreement with other loops.
    """

    i: int
    j: int
    T_i_j: Pose
    covariance: Float64
    confidence: float


@dataclass(frozen=True)
class _Node:
    """Keyframe with its submap."""

    scan: int
    travelled: float
    T_local_sensor: Pose
    submap: Submap


@dataclass(frozen=True)
class _Part:
    """Stretch of the trajectory as a map in the odometry's frame."""

    nodes: range
    localizer: Localizer | None


class LoopDetector:
    """Detect loops of a robot, scan by scan, for a SLAM back-end.

    Every few metres the cloud of the last stretch is localized in the maps of earlier parts of the
    trajectory that may be near. A loop is registered with the nearest keyframe there, and returned
    once another loop agrees with it through odometry.

    Parameters
    ----------
    config : Config, optional
        Configuration of segments, descriptors and localization.
    settings : LoopConfig, optional

    Notes
    -----
    Memory is bounded by ``max_parts``. Odometry may drift, but not jump.
    """

    def __init__(self, config: Config | None = None, settings: LoopConfig | None = None) -> None:
        self.config, self.settings = _quick(config or Config()), settings or LoopConfig()
        local, voxel = self.config.local_cloud, self.config.segmentation.accumulated.voxel_size
        short = local.model_copy(update={"window_m": self.settings.submap_m})
        self._long, self._short = RollingCloud(local, voxel), RollingCloud(short, voxel)
        self._segmenter = Segmenter(self.config.segmentation)
        self._descriptor = create(self.config.method, self.config.threads, self.config.weights)
        self._nodes: dict[int, _Node] = {}
        self._submaps: dict[int, Submap] = {}
        self._register = SubmapRegistration(self._submaps, self.settings, self.config.threads)
        self._parts: deque[_Part] = deque()
        self._growing: SegmentMap | None = None
        self._first = 0  # first node of the growing part
        self._count = self._scans = 0
        self._travelled = 0.0
        self._last: Pose | None = None
        self._found: list[tuple[Loop, float]] = []
        self._told: set[tuple[int, int]] = set()

    def __len__(self) -> int:
        """Number of keyframes kept."""
        return len(self._nodes)

    def add(
        self, scan: Scan | np.ndarray, T_odom_sensor: ArrayLike | None = None
    ) -> list[LoopClosure]:
        """Add the next scan; return loops that are newly accepted.

        Parameters
        ----------
        scan : Scan or (N, 3) array
            De-skewed points in the sensor's frame [m].
        T_odom_sensor : (4, 4) array, optional
            In the odometry's frame, whose z axis points up; by default the scan's own.

        Raises
        ------
        InvalidScan
            If the scan or its pose is invalid; nothing is changed.
        """
        scan = scan if isinstance(scan, Scan) else Scan(scan)
        own = odometry_pose(scan) if T_odom_sensor is None else T_odom_sensor
        T = checked_pose(own, "T_odom_sensor")
        self._long.add(scan, T)
        self._short.add(scan, T)
        number, self._scans = self._scans, self._scans + 1
        if self._last is not None:
            self._travelled += float(np.linalg.norm(T[:3, 3] - self._last[:3, 3]))
        self._last = T
        newest = self._nodes.get(self._count - 1)
        if newest and self._travelled - newest.travelled < self.settings.every_m:
            return []
        return self._visit(number, T)

    def _visit(self, number: int, T_odom_sensor: Pose) -> list[LoopClosure]:
        """Make a keyframe here, and search for loops."""
        node = self._keyframe(number, T_odom_sensor)
        self._nodes[self._count], self._submaps[self._count] = node, node.submap
        query = query_of(node.submap)
        for part in self._near(node):
            self._look(part, query, self._count)
        self._count += 1
        return self._tell()

    def _keyframe(self, number: int, T_odom_sensor: Pose) -> _Node:
        T_odom_local = geometry.levelled(T_odom_sensor)
        submap = add_submap(
            self._grow(T_odom_local),
            self._descriptor,
            T_odom_local,
            number,
            self._segmenter.segment(self._long.cloud()),
            self._segmenter.segment(self._short.cloud()),
            self.settings,
            self.config.local_cloud.radius_m,
        )
        T_local_sensor = geometry.inverse(T_odom_local) @ T_odom_sensor
        return _Node(number, self._travelled, T_local_sensor, submap)

    def _grow(self, T_odom_local: Pose) -> SegmentMap:
        """Return the map of the last part, or of the next one if that is long enough.

        The oldest part is forgotten.
        """
        first = self._nodes.get(self._first)
        ended = first and self._travelled - first.travelled >= self.settings.part_m
        if self._growing is not None and not ended:
            return self._growing
        if self._growing is not None:
            prior_map = self._growing
            localizer = Localizer(prior_map, self.config) if len(prior_map) else None
            self._parts.append(_Part(range(self._first, self._count), localizer))
            if len(self._parts) > self.settings.max_parts:
                self._forget(self._parts.popleft())
        self._first = self._count
        self._growing = empty_map(self._descriptor, self.config, T_odom_local[:3, 3])
        return self._growing

    def _forget(self, part: _Part) -> None:
        for k in part.nodes:
            del self._nodes[k], self._submaps[k]
        self._found = [f for f in self._found if f[0].target in self._nodes]

    def _near(self, node: _Node) -> list[_Part]:
        """Return earlier parts within reach of the keyframe, plus drift."""
        settings, near = self.settings, []
        for part in self._parts:
            ago = node.travelled - self._nodes[part.nodes[-1]].travelled
            if ago < settings.min_travel_m or part.localizer is None:
                continue
            places = np.stack([self._submaps[k].T_odom_local[:2, 3] for k in part.nodes])
            away = np.linalg.norm(places - node.submap.T_odom_local[:2, 3], axis=1).min()
            if away <= settings.reach_m + settings.drift * ago:
                near.append(part)
        return near

    def _look(self, part: _Part, query: Query, source: int) -> None:
        assert part.localizer is not None
        poses = np.stack([self._submaps[k].T_odom_local for k in part.nodes])
        found = loop_in_part(part.localizer, query, source, part.nodes, poses, self._register)
        if found is not None and found[0].accepted:
            self._found.append(found)

    def _tell(self) -> list[LoopClosure]:
        """Return new loops that enough others agree with."""
        here = self._travelled
        reach = 2.0 * self.settings.support_m
        self._found = [f for f in self._found if here - self._nodes[f[0].source].travelled <= reach]
        closures = []
        for loop, (_, confidence) in zip(self._agreeing(), self._found, strict=True):
            key = (loop.target, loop.source)
            if loop.accepted and key not in self._told:
                self._told.add(key)
                closures.append(self._closure(loop, confidence))
        self._told &= {(loop.target, loop.source) for loop, _ in self._found}
        return closures

    def _agreeing(self) -> list[Loop]:
        """Return recent loops, with a reason for those that too few agree with."""
        loops = [loop for loop, _ in self._found]
        if not loops or not self.settings.min_support:
            return loops
        ends = sorted({k for loop in loops for k in (loop.target, loop.source)})
        place = {k: n for n, k in enumerate(ends)}
        chain = Chain(
            np.zeros(len(ends), np.int64),
            np.array([self._nodes[k].travelled for k in ends]),
            np.stack([self._submaps[k].T_odom_local for k in ends]),
            [],
        )
        placed = [
            replace(loop, target=place[loop.target], source=place[loop.source]) for loop in loops
        ]
        checked = reject_unsupported(chain, placed, self.settings)
        return [
            replace(loop, reason=result.reason) for loop, result in zip(loops, checked, strict=True)
        ]

    def _closure(self, loop: Loop, confidence: float) -> LoopClosure:
        """Convert a loop between local frames of keyframes to one between their sensors."""
        i, j = self._nodes[loop.target], self._nodes[loop.source]
        T = geometry.inverse(i.T_local_sensor) @ loop.T_target_source @ j.T_local_sensor
        covariance = geometry.rotated_covariance(loop.covariance, j.T_local_sensor)
        assert covariance is not None
        return LoopClosure(i.scan, j.scan, T, covariance, confidence)


def _quick(config: Config) -> Config:
    """Return the configuration without searches of a whole map: the next keyframe follows soon."""
    occupancy = config.occupancy.model_copy(update={"enabled": False})
    return config.model_copy(update={"occupancy": occupancy, "proposers": ()})
