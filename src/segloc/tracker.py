"""Localization over time: one posterior over the place of a robot, updated view by view."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from . import geometry
from .errors import InvalidScan
from .frontend.local_cloud import Scans
from .frontend.rolling_cloud import RollingCloud
from .likelihood import ScoredPose
from .localization import Localization
from .localizer import Localizer
from .pipeline import Search
from .prior import Prior
from .proposals.proposer import Query
from .system.checks import checked_pose
from .system.stage_times import StageTimes
from .tracking.belief import Belief, BeliefConfig, Reading, Status, View
from .types import Float64, LocalCloud, Pose, Scan

QueryCallback = Callable[[Query, Search, Localization], None]
"""Receives a query, the result of its search, and the answer."""

_MIN_RATIO_TERM = 1e-300
_MAX_CHECKED, _MIN_CHECKED_P = 3, 0.01
"""Most hypotheses that a scan is compared at, and their least probability."""


class TrackerConfig(BeliefConfig):
    """Rate of views, their clouds, and the filter over them."""

    accumulate: bool = Field(
        False, description="search with the accumulated scans of the last stretch"
    )
    every_m: float = Field(0.0, ge=0, description="travel between searches while localized [m]")
    searching_m: float = Field(4.0, ge=0, description="travel between searches otherwise [m]")
    check_m: float = Field(
        2.0, gt=0, description="travel between comparisons of the newest scan with the map [m]"
    )


@dataclass(frozen=True)
class Track:
    """The state of a tracker.

    Attributes
    ----------
    status : Status
    T_map_odom : (4, 4) float64 or None
        Transforms odometry poses to the map; None while lost or candidate.
    confidence : float
        Probability of the most probable place, in [0, 1].
    views : int
        Number of independent views that support it.
    reason : str
        Why the status is not better; "" when localized.
    covariance : (6, 6) float64 or None
        Covariance of the sensor's pose in the map, as :attr:`segloc.Localized.covariance`.
    """

    status: Status
    T_map_odom: Pose | None
    confidence: float
    views: int
    reason: str = ""
    covariance: Float64 | None = None

    @property
    def localized(self) -> bool:
        """Whether there is a pose: localized or degraded."""
        return self.T_map_odom is not None


@dataclass(frozen=True)
class QueryRequest:
    """A view that is due, with its inputs: any thread can compute it later.

    With ``search``, the map is searched for ``scans``. The ``newest`` scan is compared with the map
    at the ``hypotheses`` (T_map_odom by key). Views of an earlier ``epoch`` are ignored.
    """

    search: bool
    scans: Scans | LocalCloud
    newest: Scan | LocalCloud | None
    hypotheses: Mapping[int, Pose]
    view: View
    epoch: int


class Tracker:
    """Localizes a robot over successive queries by a Bayes filter.

    Places found by queries become hypotheses. Odometry moves and blurs them, and leaks their
    probability to "lost". Views update their probabilities and that of "lost".

    Parameters
    ----------
    localizer : Localizer
    config : TrackerConfig, optional
        With ``accumulate``, pass every scan to :meth:`update`, at the rate of the sensor.

    Attributes
    ----------
    rolling : RollingCloud or None
        Accumulated scans of the next search.
    belief : Belief
    travelled : float
        Distance travelled [m].
    """

    def __init__(self, localizer: Localizer, config: TrackerConfig | None = None) -> None:
        self.localizer, self.config = localizer, config or TrackerConfig()
        settings = localizer.config
        verification, separation = settings.verification, settings.pose.separation
        self.belief = Belief(self.config, verification.min_confidence, separation)
        self.travelled, self._epoch = 0.0, 0
        self._last: Pose | None = None
        self._searched = self._checked = self._begun = -math.inf  # distances travelled
        self.rolling: RollingCloud | None = None
        if self.config.accumulate:
            voxel_size = settings.segmentation.accumulated.voxel_size
            self.rolling = RollingCloud(settings.local_cloud, voxel_size)

    def update(self, scans: Scans | LocalCloud, T_odom_sensor: ArrayLike) -> Track:
        """Process the next query, or the next scan of one.

        Parameters
        ----------
        scans : Scan, (N, 3) array, list of Scan, or LocalCloud
            As for :meth:`Localizer.localize`; one scan if the tracker accumulates.
        T_odom_sensor : (4, 4) array
            Pose of the (last) scan's sensor in the odometry's frame, whose z axis is vertical.

        Raises
        ------
        InvalidScan
            If the pose is not a rigid transform, or the scans cannot be accumulated.
        """
        request = self.add(scans, T_odom_sensor)
        if request is not None:
            self.take(request, self.ask(request))
        return self.track

    @property
    def track(self) -> Track:
        """The current state."""
        status, reason = self.belief.status()
        if not self.belief.hypotheses:
            return Track(status, None, 0.0, 0, reason)
        best = self.belief.hypotheses[0]
        known = best.probability, int(best.views), reason
        if not best.accepted or self._last is None:
            return Track(status, None, *known)
        return Track(status, best.T_map_odom, *known, self.belief.covariance(self._last))

    def add(
        self, scans: Scans | LocalCloud, T_odom_sensor: ArrayLike, *, due: bool = False
    ) -> QueryRequest | None:
        """Add scans, the first third of :meth:`update`; return a request if a view is due.

        With ``due``, a search is due after any distance.
        """
        T, config = checked_pose(T_odom_sensor, "T_odom_sensor"), self.config
        if self.rolling is not None:
            if not isinstance(scans, (Scan, np.ndarray)):
                raise InvalidScan("a tracker that accumulates takes one scan at a time")
            self.rolling.add(scans, T)
        if self._last is not None:
            metres = float(np.linalg.norm(T[:3, 3] - self._last[:3, 3]))
            self.travelled += metres
            self.belief.move(metres)
        self._last = T
        localized = self.belief.status()[0] is Status.LOCALIZED
        every = config.every_m if localized else min(config.every_m, config.searching_m)
        search = due or self.travelled - self._searched >= every
        likely = [
            h for h in self.belief.hypotheses[:_MAX_CHECKED] if h.probability > _MIN_CHECKED_P
        ]
        if search or (likely and self.travelled - self._checked >= config.check_m):
            return self._request(scans, T, search, {h.key: h.T_map_odom for h in likely})
        return None

    def _request(
        self, scans: Scans | LocalCloud, T: Pose, search: bool, hypotheses: Mapping[int, Pose]
    ) -> QueryRequest:
        new_check = min(1.0, (self.travelled - self._checked) / self.config.check_m)
        new_search = new_check
        if self.rolling is not None or (isinstance(scans, Sequence) and len(scans) > 1):
            begun_m = self.travelled - self._begun
            window_m = min(self.localizer.config.local_cloud.window_m, begun_m)
            window_m = max(window_m, self.config.check_m)
            new_search = min(1.0, (self.travelled - self._searched) / window_m)
        view = View(self.belief.travelled, T, new_check, new_search)
        self._checked = self.travelled
        newest = _newest(scans, T)
        if search:
            self._searched = self.travelled
            scans = scans if self.rolling is None else self.rolling.cloud()
        return QueryRequest(search, scans, newest, hypotheses, view, self._epoch)

    def ask(
        self,
        request: QueryRequest,
        deadline_ms: float | None = None,
        *,
        near: Prior | None = None,
        callback: QueryCallback | None = None,
    ) -> View:
        """Compute a view, the second third of :meth:`update`; any thread may.

        ``deadline_ms`` and ``near`` bound the search as in :meth:`Localizer.localize`; ``callback``
        receives its result.
        """
        view, localizer = request.view, self.localizer
        if request.search:
            times = StageTimes(localizer.clock)
            query = localizer.describe(request.scans, times)
            found, result = localizer.answer(query, times, deadline_ms, near)
            if callback is not None:
                callback(query, found, result)
            posterior = found.posterior
            view = replace(
                view,
                places=[
                    _reading(
                        pose,
                        math.log(
                            max(p, _MIN_RATIO_TERM) / max(posterior.not_in_map, _MIN_RATIO_TERM)
                        ),
                        query.cloud,
                        view,
                    )
                    for pose, p in zip(posterior.places, posterior.probabilities, strict=True)
                ],
            )
        if request.newest is None or not request.hypotheses:
            return view
        cloud = request.newest
        if isinstance(cloud, Scan):
            cloud = localizer.accumulator.gather(cloud)
        scene = localizer.segmenter.segment(cloud)
        if not len(scene.structure):
            return view
        T_odom_local = view.T_odom_sensor @ geometry.inverse(cloud.T_local_sensor)
        checks, scans = {}, {}
        for key, T_map_odom in request.hypotheses.items():
            here = localizer.around((T_map_odom @ view.T_odom_sensor)[:3, 3])
            if here is None:
                continue
            if here not in scans:
                scans[here] = here.likelihood.query(scene)
            pose = here.likelihood.at(scans[here], T_map_odom @ T_odom_local)
            checks[key] = _reading(pose, pose.log_ratio, cloud, view)
        return replace(view, checks=checks)

    def take(self, request: QueryRequest, view: View) -> None:
        """Update the hypotheses by a view, the last third of :meth:`update`."""
        if request.epoch == self._epoch and self.belief.update(view):
            self._restart_window()

    def follow_jump(self, T_new_old: ArrayLike, problem: str) -> None:
        """Follow a jump of the odometry, as of a robot at rest; the track becomes less certain.

        Parameters
        ----------
        T_new_old : (4, 4) array
            Transform from the odometry's frame before the jump to that after it.
        problem : str
            Description of the jump.
        """
        T = checked_pose(T_new_old, "T_new_old")
        self.belief.follow_jump(T, problem)
        if self._last is not None:
            self._last = T @ self._last
        self._searched = -math.inf
        self._restart_window()

    def forget(self) -> None:
        """Drop all hypotheses, keep the scans, and search at once."""
        self.belief.clear()
        self._searched, self._epoch = -math.inf, self._epoch + 1

    def clear(self) -> None:
        """Drop all hypotheses and all scans."""
        self.forget()
        self._last = None
        self._restart_window()

    def _restart_window(self) -> None:
        """Drop the accumulated scans; searches use later ones only."""
        self._begun, self._epoch = self.travelled, self._epoch + 1
        if self.rolling is not None:
            self.rolling.clear()


def _reading(pose: ScoredPose, log_ratio: float, cloud: LocalCloud, view: View) -> Reading:
    covariance = geometry.rotated_covariance(pose.covariance, cloud.T_local_sensor)
    T_map_sensor = pose.T_map_local @ cloud.T_local_sensor
    T_map_odom = T_map_sensor @ geometry.inverse(view.T_odom_sensor)
    return Reading(T_map_odom, log_ratio, covariance, pose.known_ratio)


def _newest(scans: Scans | LocalCloud, T_odom_sensor: Pose) -> Scan | LocalCloud | None:
    """Return the last scan alone; None if it cannot be separated from the others."""
    if isinstance(scans, np.ndarray):
        return Scan(scans, T_odom_sensor=T_odom_sensor)
    if isinstance(scans, Scan):
        scans = copy.copy(scans)
        scans.T_odom_sensor = T_odom_sensor
        return scans
    last = scans[-1] if isinstance(scans, Sequence) and scans else scans
    return last if isinstance(last, (Scan, LocalCloud)) else None
