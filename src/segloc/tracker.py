"""Successive queries of one robot: hypotheses kept between them and compared through odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from . import geometry
from .checks import checked_pose
from .errors import InvalidScan
from .local_cloud import Scans
from .localization import Reason
from .localizer import Localizer
from .rolling_cloud import RollingCloud
from .section import Section
from .types import LocalCloud, Pose, Scan


class TrackerConfig(Section):
    """When hypotheses of different queries support each other."""

    min_confidence: float = Field(0.3, ge=0, le=1, description="less likely ones are not kept")
    tolerance_m: float = Field(1.0, gt=0, description="hypotheses that agree differ by less")
    tolerance_deg: float = Field(3.0, gt=0, description="the same for their headings, degrees")
    drift: float = Field(
        0.02, ge=0, description="odometry errs by this share of the distance travelled"
    )
    apart_m: float = Field(
        4.0, ge=0, description="travel between two views that witness independently, metres"
    )
    agreeing: int = Field(2, ge=2, description="views that must agree on a hypothesis")
    memory_m: float = Field(150.0, gt=0, description="unsupported hypotheses are kept this long")
    max_kept: int = Field(16, ge=1, description="hypotheses kept between queries")
    accumulate: bool = Field(
        False, description="queries are clouds of the scans over the last stretch of the path"
    )
    every_m: float = Field(
        0.0, ge=0, description="scans nearer to the last query are accumulated and not localized"
    )


@dataclass(frozen=True)
class Track:
    """Where the tracker stands after a query.

    Attributes
    ----------
    localized : bool
    T_map_odom : (4, 4) float64 or None
        Takes poses of the odometry to the map.
    confidence : float
        In [0, 1]: that of the views that agree, taken as independent. Unlike that of a single
        query it is not calibrated.
    views : int
        Independent views that agree with the track.
    reason : str
        "" when localized.
    """

    localized: bool
    T_map_odom: Pose | None
    confidence: float
    views: int
    reason: str = ""


@dataclass(frozen=True)
class _Kept:
    """A hypothesis with the last view that supported it."""

    T_map_odom: Pose
    confidence: float
    views: int
    believed: bool  # by a single view that passed all gates
    at: float  # travelled distance of the last supporting view


class Tracker:
    """Localizes a robot over successive queries.

    A single query that passes all gates of verification is believed at once. A pose that is only
    likely is kept: those on which views from different positions agree are believed, and those that
    a believed one contradicts are dropped. A believed track survives queries that find nothing, for
    ``memory_m`` of travel.

    Parameters
    ----------
    localizer : Localizer
    config : TrackerConfig, optional
        With ``accumulate``, give every scan to :meth:`update`, at the rate at which they come.

    Attributes
    ----------
    rolling : RollingCloud or None
        The scans that queries are made of, where they accumulate: to correct their poses, say.
    """

    def __init__(self, localizer: Localizer, config: TrackerConfig | None = None) -> None:
        self.localizer = localizer
        self.config = config or TrackerConfig()
        self._kept: list[_Kept] = []
        self._travelled = 0.0
        self._last: Pose | None = None
        self._queried = -math.inf  # travelled distance of the last query
        self.rolling: RollingCloud | None = None
        if self.config.accumulate:
            voxel_size = localizer.config.segmentation.accumulated.voxel_size
            self.rolling = RollingCloud(localizer.config.local_cloud, voxel_size)

    def update(self, scans: Scans | LocalCloud, T_odom_sensor: ArrayLike) -> Track:
        """Take the next query, or the next scan of one.

        Parameters
        ----------
        scans : Scan, (N, 3) array, list of Scan, or LocalCloud
            As for :meth:`Localizer.localize`; one scan where they are accumulated here.
        T_odom_sensor : (4, 4) array
            Pose of the (last) scan's sensor in the odometry's frame, whose z axis points up.

        Raises
        ------
        InvalidScan
            If the pose is not a rigid transform, or the scans cannot be accumulated.
        """
        T = checked_pose(T_odom_sensor, "T_odom_sensor")
        self._add(scans, T)
        if self._last is not None:
            self._travelled += float(np.linalg.norm(T[:3, 3] - self._last[:3, 3]))
        self._last = T
        view = self._view(scans, T) if self._is_due() else None
        if view is not None:
            self._merge(view)
        self._forget()
        return self._answer(view)

    def _add(self, scans: Scans | LocalCloud, T_odom_sensor: Pose) -> None:
        if self.rolling is None:
            return
        if not isinstance(scans, (Scan, np.ndarray)):
            raise InvalidScan("a tracker that accumulates takes one scan at a time")
        self.rolling.add(scans, T_odom_sensor)

    def _is_due(self) -> bool:
        """Whether it is time for a query."""
        if self._travelled - self._queried < self.config.every_m:
            return False
        self._queried = self._travelled
        return True

    def _view(self, scans: Scans | LocalCloud, T_odom_sensor: Pose) -> _Kept | None:
        """What one query says, if that is worth keeping.

        Where several places look alike, it says nothing: such views agree with one another at wrong
        places, too, all along a street.
        """
        config = self.config
        query = self.localizer.describe(scans if self.rolling is None else self.rolling.cloud())
        T_local_sensor = checked_pose(query.cloud.T_local_sensor, "T_local_sensor")
        verdict = self.localizer.search(query).verdict
        best, believed = verdict.best, verdict.reason is None
        if best is None or verdict.reason is Reason.AMBIGUOUS:
            return None
        if not believed and verdict.confidence < config.min_confidence:
            return None
        T_map_odom = best.T_map_local @ T_local_sensor @ geometry.inverse(T_odom_sensor)
        return _Kept(T_map_odom, verdict.confidence, 1, believed, self._travelled)

    def _merge(self, view: _Kept) -> None:
        """Let a view support the hypothesis that it agrees with, or stand for itself."""
        for i, old in enumerate(self._kept):
            if not self._agree(old, view):
                continue
            independent = view.at - old.at >= self.config.apart_m
            self._kept[i] = _Kept(
                view.T_map_odom,
                1.0 - (1.0 - old.confidence) * (1.0 - view.confidence)
                if independent
                else max(old.confidence, view.confidence),
                old.views + independent,
                old.believed or view.believed,
                view.at if independent else old.at,
            )
            return
        self._kept.append(view)

    def _agree(self, old: _Kept, view: _Kept) -> bool:
        config = self.config
        assert self._last is not None
        here = geometry.inverse(old.T_map_odom @ self._last) @ view.T_map_odom @ self._last
        slack = config.tolerance_m + config.drift * (view.at - old.at)
        turned = math.degrees(geometry.rotation_angle(here))
        return bool(np.linalg.norm(here[:3, 3]) <= slack and turned <= config.tolerance_deg)

    def _forget(self) -> None:
        """Drop what is old, what a believed hypothesis contradicts, and the weakest."""
        config = self.config
        fresh = [k for k in self._kept if self._travelled - k.at <= config.memory_m]
        fresh.sort(key=lambda k: (-k.views, -k.believed, -k.confidence))
        believed = [k for k in fresh if self._stands(k)]
        if believed and (len(believed) == 1 or believed[0].views > believed[1].views):
            fresh = [k for k in fresh if k is believed[0] or k.at > believed[0].at]
        self._kept = fresh[: config.max_kept]

    def _stands(self, kept: _Kept) -> bool:
        return kept.believed or kept.views >= self.config.agreeing

    def _answer(self, view: _Kept | None) -> Track:
        standing = [k for k in self._kept if self._stands(k)]
        if not standing:
            reason = "no agreement yet" if self._kept else "nothing found"
            return Track(False, None, 0.0, max((k.views for k in self._kept), default=0), reason)
        best = standing[0]
        if len(standing) > 1 and standing[1].views >= best.views:
            return Track(False, None, 0.0, best.views, "contradiction")
        if view is not None and view.believed and not self._agree(best, view):
            return Track(False, None, 0.0, best.views, "contradiction")
        return Track(True, best.T_map_odom, best.confidence, best.views)
