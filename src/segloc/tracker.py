"""Successive queries of one robot: hypotheses kept between them and compared through odometry."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from . import geometry
from .errors import InvalidScan
from .frontend.local_cloud import Scans
from .frontend.rolling_cloud import RollingCloud
from .likelihood import RefinedScore
from .localization import Reason
from .localizer import Localizer
from .pipeline import Search
from .prior import Prior
from .proposals.proposer import Query
from .system.checks import checked_pose
from .system.stage_times import StageTimes
from .tracking.hypotheses import Hypotheses
from .tracking.scan_check import ScanCheck, ScanCheckConfig, newest_alone
from .tracking.views import Check, HypothesesConfig, View
from .tracking.views import Question as Question
from .tracking.views import Track as Track
from .types import LocalCloud, Pose, Scan

Heard = Callable[[Query, Search, Mapping[str, float]], None]
"""Told what a query was, what was found, and how many milliseconds each stage took."""


class TrackerConfig(HypothesesConfig):
    """When queries are made, of what, and what is believed of them."""

    accumulate: bool = Field(
        False, description="queries are clouds of the scans over the last stretch of the path"
    )
    every_m: float = Field(
        0.0, ge=0, description="scans nearer to the last query are accumulated and not localized"
    )
    searching_m: float = Field(
        4.0, ge=0, description="the same while there is no track, or it is contradicted, metres"
    )
    check_m: float = Field(
        2.0, ge=0, description="between queries the track is checked by single scans, so far apart"
    )
    check: ScanCheckConfig = ScanCheckConfig()


class Tracker:
    """Localizes a robot over successive queries.

    A query that passes all gates is believed at once, and after some travel where queries before it
    found places alike. Poses that are only likely are kept until views that share no scan agree on
    one. A track survives queries that find nothing, for ``memory_m`` of travel, and ends once the
    map contradicts it twice in a row.

    Parameters
    ----------
    localizer : Localizer
    config : TrackerConfig, optional
        With ``accumulate``, give every scan to :meth:`update`, at the rate at which they come.

    Attributes
    ----------
    rolling : RollingCloud or None
        The scans that queries are made of, where they accumulate: to correct their poses, say.
    travelled : float
        Metres.
    """

    def __init__(self, localizer: Localizer, config: TrackerConfig | None = None) -> None:
        self.localizer = localizer
        self.config = config or TrackerConfig()
        self.travelled = 0.0
        self._hypotheses = Hypotheses(self.config)
        self._epoch = 0
        self._check = ScanCheck(localizer, self.config.check)
        self._last: Pose | None = None
        self._foreign = False  # whether the newest scan showed the track's place
        self._queried = self._checked = -math.inf  # metres travelled at the last query and check
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
        question = self.add(scans, T_odom_sensor)
        if question is not None:
            self.take(question, self.ask(question))
        return self.track

    @property
    def track(self) -> Track:
        """Where the tracker stands."""
        hypotheses = self._hypotheses
        status, reason = hypotheses.status(self.travelled)
        if (best := hypotheses.track) is not None and self._last is not None:
            covariance = hypotheses.covariance(self.travelled, self._last)
            return Track(status, best.T_map_odom, best.confidence, best.views, reason, covariance)
        views = max((k.views for k in hypotheses.candidates), default=0)
        return Track(status, None, 0.0, views, reason)

    def add(
        self, scans: Scans | LocalCloud, T_odom_sensor: ArrayLike, *, due: bool = False
    ) -> Question | None:
        """The first third of :meth:`update`: take scans, and say what is to be asked, if anything.

        Parameters
        ----------
        scans, T_odom_sensor
            As for :meth:`update`.
        due : bool
            Whether to ask however little was travelled since the last query.
        """
        T = checked_pose(T_odom_sensor, "T_odom_sensor")
        self._add(scans, T)
        if self._last is not None:
            self.travelled += float(np.linalg.norm(T[:3, 3] - self._last[:3, 3]))
        self._last = T
        self._hypotheses.forget(self.travelled)
        track = self._hypotheses.track
        search = due or self._is_due()
        if not search and (track is None or self.travelled - self._checked < self.config.check_m):
            return None
        self._checked = self.travelled
        cloud = self.rolling.cloud() if search and self.rolling is not None else scans
        self._queried = self.travelled if search else self._queried
        expected = None if track is None else track.T_map_odom
        newest = newest_alone(scans, T)
        reach_m = self._reach(scans)
        return Question(search, cloud, newest, T, expected, self.travelled, reach_m, self._epoch)

    def ask(
        self,
        question: Question,
        deadline_ms: float | None = None,
        *,
        near: Prior | None = None,
        heard: Heard | None = None,
    ) -> View:
        """The second third, and nearly all of the work; it changes nothing in the tracker.

        Where places look alike it names none: such views agree at wrong places, too.

        Parameters
        ----------
        question : Question
        deadline_ms : float, optional
        near : Prior, optional
            Where alone it is looked for, as for :meth:`Localizer.localize`.
        heard : callable, optional
            Called with the query, the search and the times of the stages, where there was a search.
        """
        if not question.search:
            return self._checked_by(question, None)
        times = StageTimes(self.localizer.clock)
        query = self.localizer.describe(question.scans, times)
        with times("check"):
            view = self._checked_by(question, query)
        T_local_sensor = checked_pose(query.cloud.T_local_sensor, "T_local_sensor")
        found = self.localizer.search(query, times, deadline_ms, near)
        verdict = found.verdict
        if heard is not None:
            heard(query, found, times.with_total())
        best, believed = verdict.best, verdict.reason is None
        if best is None or verdict.reason is Reason.AMBIGUOUS:
            return replace(view, ambiguous=best is not None)
        if not believed and verdict.confidence < self.config.min_confidence:
            return view
        T_map_sensor = best.T_map_local @ T_local_sensor
        covariance = best.covariance if isinstance(best, RefinedScore) else None
        said_more = query.cloud.num_scans == 1 and view.check is Check.UNDECIDED
        return replace(
            view,
            T_checked=None if said_more else view.T_checked,
            T_map_odom=T_map_sensor @ geometry.inverse(question.T_odom_sensor),
            confidence=verdict.confidence,
            believed=believed,
            covariance=geometry.rotated_covariance(covariance, T_local_sensor),
        )

    def _checked_by(self, question: Question, query: Query | None) -> View:
        """A view that says no more than what the newest scan says of the track."""
        T_odom_sensor, newest = question.T_odom_sensor, question.newest
        view = View(question.at, T_odom_sensor, reach_m=question.reach_m)
        if question.T_map_odom is None or newest is None:
            return view
        if query is not None and query.cloud.num_scans == 1:
            cloud, scene = query.cloud, query.scene
        else:
            cloud, scene = self._check.scene(newest)
        check, T_map_sensor, covariance = self._check.at(
            cloud, scene, question.T_map_odom @ T_odom_sensor
        )
        T_checked = T_map_sensor @ geometry.inverse(T_odom_sensor)
        return replace(view, check=check, T_checked=T_checked, checked_covariance=covariance)

    def take(self, question: Question, view: View) -> None:
        """The last third: let what was found support the track, or speak against it."""
        if question.epoch != self._epoch:
            return
        self._hypotheses.take(view)
        if view.check in (Check.CONTRADICTS, Check.UNMAPPED) and not self._foreign:
            self._begin_anew()  # the scans before show another place, perhaps
        self._foreign = view.check in (Check.CONTRADICTS, Check.UNMAPPED)

    def carry(self, T_new_old: ArrayLike, doubt: str) -> None:
        """Follow a jump of the odometry: the robot is taken to stand where it stood before it.

        The track is degraded until the map confirms it.

        Parameters
        ----------
        T_new_old : (4, 4) array
            From the odometry's frame before the jump to that after it.
        doubt : str
            What happened.
        """
        T = checked_pose(T_new_old, "T_new_old")
        self._hypotheses.carry(T, self.travelled, doubt)
        if self._last is not None:
            self._last = T @ self._last
        self._queried = -math.inf
        self._begin_anew()

    def forget(self) -> None:
        """Forget the track and what was likely; keep the scans, and ask at once."""
        self._hypotheses.clear()
        self._queried, self._epoch = -math.inf, self._epoch + 1

    def clear(self) -> None:
        """Forget the track and all scans."""
        self._hypotheses.clear()
        self._last, self._queried = None, -math.inf
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Let queries be made of what comes from now on."""
        self._epoch += 1
        if self.rolling is not None:
            self.rolling.clear()

    def _add(self, scans: Scans | LocalCloud, T_odom_sensor: Pose) -> None:
        if self.rolling is None:
            return
        if not isinstance(scans, (Scan, np.ndarray)):
            raise InvalidScan("a tracker that accumulates takes one scan at a time")
        self.rolling.add(scans, T_odom_sensor)

    def _reach(self, scans: Scans | LocalCloud) -> float:
        """How far back the oldest scan of a query is, metres."""
        if self.rolling is not None:
            return float(geometry.travelled(self.rolling.poses)[-1])
        if not isinstance(scans, Sequence):
            return 0.0
        poses = [scan.T_odom_sensor for scan in scans if isinstance(scan, Scan)]
        known = [T for T in poses if T is not None]
        return float(geometry.travelled(np.array(known))[-1]) if known else 0.0

    def _is_due(self) -> bool:
        every = self.config.every_m
        if self._hypotheses.track is None or self._hypotheses.contradicted:
            every = min(every, self.config.searching_m)
        return self.travelled - self._queried >= every
