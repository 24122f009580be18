"""Localization over time: one posterior over the place of a robot, updated view by view."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from . import geometry
from .errors import InvalidScan
from .frontend.local_cloud import Scans
from .frontend.rolling_cloud import RollingCloud
from .likelihood import Posterior
from .localization import Localization
from .localizer import Localizer
from .pipeline import Search
from .prior import MAX_RADIUS_M, Prior, allowed
from .proposals.proposer import Query
from .system.checks import checked_height, checked_pose
from .system.stage_times import StageTimes
from .tracking.belief import (
    Belief,
    BeliefConfig,
    Height,
    Hypothesis,
    Reading,
    Status,
    View,
)
from .types import Float64, LocalCloud, Pose, Scan

Found = tuple[Query, Search, Localization]
"""A query, the result of its search, and the answer."""

_MIN_PROBABILITY = 1e-300
_WEAK = 1.5
"""Evidence of a view for the track, below which the map is searched at once."""
_HEIGHT_SIGMAS = 3.0
"""Standard deviations of an observed height beyond which a place is elsewhere."""
_SOONER = 0.25
"""Share of the travel between views after which a correction is looked at again."""
_MAX_CHECKED, _MIN_CHECKED_P = 4, 0.01
"""Most hypotheses that a view is compared at, and their least probability."""


class TrackerConfig(BeliefConfig):
    """Rate of views, their clouds, and the filter over them."""

    accumulate: bool = Field(
        False, description="search with the accumulated scans of the last stretch"
    )
    every_m: float = Field(0.0, ge=0, description="travel between searches while localized [m]")
    searching_m: float = Field(4.0, ge=0, description="travel between searches otherwise [m]")
    check_m: float = Field(
        2.0, gt=0, description="travel between views, that is of the newest scan [m]"
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


@dataclass(frozen=True, kw_only=True)
class QueryRequest(View):
    """A view from when it is due until it is taken: any thread can make it.

    Attributes
    ----------
    scans : Scan, list of Scan or LocalCloud
        The newest scan, or the scans of the last stretch.
    hypotheses : sequence of (4, 4) float64
        T_map_odom of those that are compared, the most probable first.
    search : bool
        Whether the map is searched, too.
    settled : bool
        Whether the robot is localized: then a view that is weak becomes a search.
    epoch : int
        Views of an earlier epoch are ignored.
    stamp : float
        Of the newest scan [s].
    near : Prior or None
        Where the map is searched first; None for all of it.
    height : Prior or None
        Height that was observed; places elsewhere are no rivals.
    found : (Query, Search, Localization) or None
        The search of the map, once it is made.
    """

    scans: Scans | LocalCloud
    hypotheses: Sequence[Pose]
    search: bool
    settled: bool
    epoch: int
    stamp: float = math.nan
    near: Prior | None = None
    height: Prior | None = None
    found: Found | None = None


class Tracker:
    """Localizes a robot over successive queries by a Bayes filter.

    Places found by queries become hypotheses. Odometry moves and blurs them, and leaks their
    probability to "lost". Each view is one cloud, measured at the hypotheses and at what a search
    proposes alike: that of the last stretch and the newest scan in turns while it is open where the
    robot is, and the newest scan alone once it is known, since what was seen before a robot was
    carried away has no vote.

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
        known = localizer.likelihood.model.known
        self.belief = Belief(self.config, verification.min_confidence, separation, known.alike)
        self.travelled, self._epoch = 0.0, 0
        self._last: Pose | None = None
        self._searched = self._viewed = -math.inf  # distances travelled
        self._alone = False  # the last search was of the newest scan
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
            self.take(self.ask(request))
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
        metres = 0.0 if self._last is None else float(np.linalg.norm(T[:3, 3] - self._last[:3, 3]))
        self.travelled += metres
        self.belief.move(metres)
        self._last = T
        localized = self.belief.status()[0] is Status.LOCALIZED
        every = config.every_m if localized else min(config.every_m, config.searching_m)
        search = due or self.travelled - self._searched >= every
        # Of the scans, a view takes the one that is nearest to its distance.
        is_near = self.travelled - self._viewed + 0.5 * metres >= self._view_m
        if search or (self._probable and is_near):
            return self._request(scans, T, search, localized)
        return None

    @property
    def _view_m(self) -> float:
        """Travel from one view to the next: less if a correction waits to be repeated."""
        track = self.belief.track
        doubts = track is not None and track.doubted is not None
        return self.config.check_m * (_SOONER if doubts else 1.0)

    @property
    def _probable(self) -> list[Hypothesis]:
        """The hypotheses that views are compared at."""
        best = self.belief.hypotheses[:_MAX_CHECKED]
        return [h for h in best if h.probability > _MIN_CHECKED_P]

    def _request(
        self, scans: Scans | LocalCloud, T: Pose, search: bool, settled: bool
    ) -> QueryRequest:
        new = min(1.0, (self.travelled - self._viewed) / self.config.check_m)
        self._viewed = self.travelled
        newest = _newest(scans, T)
        search = search or newest is None
        if search:
            self._searched = self.travelled
            # In turns: either finds what the other does not, and the stretch may hold two places.
            self._alone = settled or (not self._alone and bool(self._probable))
        alone = newest is not None and (self._alone or not search)
        if self.rolling is not None and len(self.rolling) > 1 and not alone:
            scans = self.rolling.cloud()
        elif newest is not None and (alone or not isinstance(scans, Sequence)):
            scans = newest
        return QueryRequest(
            self.belief.travelled,
            T,
            new,
            scans=scans,
            hypotheses=[h.T_map_odom for h in self._probable],
            search=search,
            settled=settled,
            epoch=self._epoch,
            height=self._height(T),
        )

    def _height(self, T: Pose) -> Prior | None:
        """Return the height that was observed, as a prior of a sensor at T_odom_sensor.

        If the most probable place is not there, either may be wrong: the search goes on anywhere.
        """
        belief = self.belief
        if belief.height is None:
            return None
        metres, sigma = belief.height.expected(T, belief.travelled, self.config.drift_up)
        tolerance = min(_HEIGHT_SIGMAS * sigma, MAX_RADIUS_M)
        height = Prior(height_m=metres, height_tolerance_m=tolerance)
        agrees = bool(belief.hypotheses) and height.holds(belief.hypotheses[0].T_map_odom @ T)
        return replace(height, anywhere=not agrees)

    def ask(self, request: QueryRequest, deadline_ms: float | None = None) -> QueryRequest:
        """Make a view, the second third of :meth:`update`; any thread may.

        ``deadline_ms`` bounds each search as in :meth:`Localizer.localize`.
        """
        if request.search:
            return self._search(request, deadline_ms)
        view = self._compare(request)
        weak = request.settled and self._is_weak(view)
        return self._search(request, deadline_ms) if weak else view

    def _search(self, request: QueryRequest, deadline_ms: float | None) -> QueryRequest:
        """Search the map, the hypotheses among the places."""
        times = StageTimes(self.localizer.clock)
        query = self.localizer.describe(request.scans, times)
        known = _known_poses(request, query.cloud)
        near, height = request.near, request.height
        if near is not None and height is not None:
            at, tolerance = height.height_m, height.height_tolerance_m
            near = replace(near, height_m=at, height_tolerance_m=tolerance)
        search, result = self.localizer.answer(query, times, deadline_ms, near or height, known)
        *others, _ = _by_storey(request, known)
        places = self._compared(request, query.cloud, others)
        places += self._places(request, search.posterior, query.cloud)
        return replace(request, places=places, searched=True, found=(query, search, result))

    def _compare(self, request: QueryRequest) -> QueryRequest:
        """Compare the newest scan at the hypotheses alone."""
        cloud = self.localizer.accumulator.gather(request.scans)
        rivals = _by_storey(request, _known_poses(request, cloud))
        return replace(request, places=self._compared(request, cloud, rivals))

    def _compared(
        self, view: View, cloud: LocalCloud, rivals: Sequence[Sequence[Pose]]
    ) -> list[Reading]:
        """Compare a cloud at poses T_map_local, those of each group among each other."""
        posteriors = [self.localizer.compare(cloud, each) for each in rivals]
        return [place for each in posteriors for place in self._places(view, each, cloud)]

    def _places(self, view: View, posterior: Posterior, cloud: LocalCloud) -> list[Reading]:
        """Return the places of a posterior."""
        known, none = self.localizer.likelihood.model.known, posterior.not_in_map
        T_local_odom = cloud.T_local_sensor @ geometry.inverse(view.T_odom_sensor)
        return [
            Reading(
                place.T_map_local @ T_local_odom,
                place.evidence,
                known.information(place.unknown),
                math.log(max(p, _MIN_PROBABILITY) / none),
                geometry.rotated_covariance(place.covariance, cloud.T_local_sensor),
            )
            for place, p in zip(posterior.places, posterior.probabilities, strict=True)
        ]

    def _is_weak(self, view: QueryRequest) -> bool:
        """Return whether a view says little for the best hypothesis, or speaks against it."""
        seen = view.reading(view.hypotheses[0], self.localizer.config.pose.separation)
        return seen is None or seen.evidence < _WEAK

    def take(self, view: QueryRequest) -> None:
        """Update the hypotheses by a view, the last third of :meth:`update`."""
        if view.epoch == self._epoch and self.belief.update(view):
            self._restart_window()

    def observe_height(
        self, height_m: float, sigma_m: float, T_odom_sensor: ArrayLike | None = None
    ) -> None:
        """Update the hypotheses by a height of the sensor, as of a barometer or a lift.

        Parameters
        ----------
        height_m, sigma_m : float
            In the map's frame, and its standard deviation [m]. A wrong height costs probability
            once, however often it is observed.
        T_odom_sensor : (4, 4) array, optional
            Where it was observed, by odometry; by default at the newest scan.

        Raises
        ------
        InvalidScan
            If a number is not finite, the deviation is negative, or the pose is no transform.
        """
        known = checked_height(height_m, sigma_m)
        T = self._last if T_odom_sensor is None else checked_pose(T_odom_sensor, "T_odom_sensor")
        height = Height(*known, self.belief.travelled, np.eye(4) if T is None else T)
        if self.belief.observe(height):
            self._restart_window()
            self._searched = -math.inf

    def forget_height(self) -> None:
        """Take heights that were observed for old: new places are found on every storey."""
        self.belief.height = None

    def suppose(self, T_map_odom: ArrayLike, probability: float = 0.5) -> None:
        """Take a pose known from elsewhere, as from another map, until views confirm or refute it.

        Parameters
        ----------
        T_map_odom : (4, 4) array
        probability : float
            That it is right, in (0, 1).
        """
        T = checked_pose(T_map_odom, "T_map_odom")
        self.belief.suppose(T, np.eye(4) if self._last is None else self._last, probability)
        self._searched = -math.inf

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
        self._searched = self._viewed = -math.inf
        self._restart_window()

    def forget(self) -> None:
        """Drop all hypotheses and the scans, of which some may be of another place; search at once.

        A robot is told so after it was carried.
        """
        self.belief.clear()
        self._searched = -math.inf
        self._restart_window()

    def _restart_window(self) -> None:
        """Drop the accumulated scans; searches use later ones only."""
        self._epoch += 1
        if self.rolling is not None:
            self.rolling.clear()


def _known_poses(request: QueryRequest, cloud: LocalCloud) -> list[Pose]:
    """Return the hypotheses as poses T_map_local of a cloud."""
    T_odom_local = request.T_odom_sensor @ geometry.inverse(cloud.T_local_sensor)
    return [T_map_odom @ T_odom_local for T_map_odom in request.hypotheses]


def _by_storey(request: QueryRequest, known: Sequence[Pose]) -> list[list[Pose]]:
    """Divide poses by the height: each that it excludes alone, and last those that it allows.

    Places that it excludes are no rivals, neither of those nor of each other.
    """
    holds = allowed(request.height)
    return [*([T] for T in known if not holds(T)), [T for T in known if holds(T)]]


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
