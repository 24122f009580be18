"""Online localization event by event, without threads or clock: a stream always gives the same
states."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import geometry
from ..errors import SeglocError
from ..localization import Explained
from ..localizer import Localizer
from ..motion import Motion, at_stamp
from ..system.checks import checked_height, checked_pose
from ..tracker import QueryRequest, Tracker
from ..tracking.belief import Status
from ..types import Float64, Pose, Scan
from .config import LiveConfig
from .kept_pose import PoseKeeper
from .lidar_odometry import LidarOdometry
from .odometry import Cover, Jump, Odometry, known_stamp, span


class StateReason(Explained):
    """Why a robot is not localized, with the likely cause and its remedy.

    The value may hold fields: seconds, metres, or the size of a jump.
    """

    NOTHING_FOUND = "nothing found", "no place is probable yet", "drive some metres"
    NO_AGREEMENT = "no agreement yet", "no place is probable enough yet", "drive some metres"
    SEVERAL_PLACES = "several places fit", "places look alike", "drive some metres"
    UNSUPPORTED = (
        "no view supports the track for {metres:.0f} m",
        "the robot left the map, or the place has changed",
        "drive back into the map",
    )
    CONTRADICTED = (
        "the map contradicts the track",
        "the robot was kidnapped, or something large blocks the view",
        "wait: the robot is searched again",
    )
    HEIGHT = (
        "the height contradicts the track",
        "the robot was on a lift, or what observes the height is wrong",
        "drive on: the robot is searched again",
    )
    JUMP = (
        "the odometry jumped by {size}",
        "the odometry was reset, or wheels slipped",
        "check the odometry",
    )
    ODOMETRY_LOST = (
        "odometry is lost: {fault}",
        "odometry from the scans: they do not overlap",
        "drive on: it restarts at its last pose",
    )
    SCANS_MISSING = (
        "no scans for {seconds:.1f} s",
        "odometry from the scans: some are missing",
        "drive on: it restarts at its last pose",
    )
    NO_ODOMETRY = (
        "no odometry at the time of the scan",
        "clocks differ, or messages are late",
        "compare stamps",
    )
    REJECTED = "scan rejected: {error}", "the scan is invalid; see the error", "fix the driver"
    NO_SCAN = (
        "no scan for {seconds:.1f} s",
        "scans are missing",
        "check the sensor's driver and the network",
    )
    NO_DATA = (
        "no data received for {seconds:.1f} s",
        "scans and odometry are missing",
        "check drivers and the network",
    )

    def __str__(self) -> str:
        return str.__str__(self)


class LiveCore:
    """Take scans and odometry, and return the robot's state after each.

    Queries take long, so they are separate: :meth:`due` returns one to make, :meth:`ask` makes it
    without side effects, in any thread, and :meth:`answer` applies the result.

    Parameters
    ----------
    localizer : Localizer
    config : LiveConfig, optional
    T_base_sensor : (4, 4) array, optional
        Mount of the sensor on the base of the odometry; by default ``local_cloud.mount``, or else
        the sensor is the base.
    lidar_odometry : bool
        Compute the odometry from the scans, by KISS-ICP; none is to be added then.
    keeper : PoseKeeper, optional
        Keeps the pose over a restart.

    Attributes
    ----------
    scans : int
        Scans used.
    dropped : int
        Scans that were late, or without odometry.
    refused, jumps : int
        Unusable scans; jumps of the odometry.
    unused_heights : int
        Observed heights that were old, or without odometry at their time.
    skipped, behind_s : int, float
        Scans that came too fast, and delay of other inputs [s], in a :class:`Shell`.
    """

    def __init__(
        self,
        localizer: Localizer,
        config: LiveConfig | None = None,
        T_base_sensor: ArrayLike | None = None,
        *,
        lidar_odometry: bool = False,
        keeper: PoseKeeper | None = None,
    ) -> None:
        self.config = config or LiveConfig()
        self._local_cloud = localizer.config.local_cloud
        mount = self._local_cloud.mount.T_base_sensor
        given = np.eye(4) if mount is None else mount
        self.T_base_sensor = checked_pose(
            given if T_base_sensor is None else T_base_sensor, "T_base_sensor"
        )
        self.tracker = Tracker(localizer, self.config.tracker)
        self.keeper = keeper
        if keeper is not None:
            keeper.use(localizer.prior_map)
        self._lidar_odometry: LidarOdometry | None = None
        if lidar_odometry:
            self._lidar_odometry = LidarOdometry(self.T_base_sensor, self._local_cloud.attitude)
        self.scans = self.dropped = self.refused = self.jumps = self.skipped = 0
        self.unused_heights, self._height_at = 0, -math.inf
        self.behind_s = 0.0
        self._odometry = Odometry(self.config)
        self._waiting: deque[tuple[float, Scan]] = deque()
        self._newest = -math.inf  # stamp of the newest scan received
        self._asked_at = -math.inf
        self._due: QueryRequest | None = None
        self._open = False  # True while a query is being made
        self._fault = ""  # why the track is unreliable, whatever the tracker reports
        self.state = State(0.0, Status.LOST, reason="no data received")

    # --- input ---------------------------------------------------------------------------------

    def add_odometry(self, stamp: float, T_odom_base: ArrayLike) -> list[State]:
        """Add a pose of the odometry.

        Parameters
        ----------
        stamp : float
            On the scans' clock [s].
        T_odom_base : (4, 4) array
            Pose of the base in the odometry's frame, whose z axis points up.

        Returns
        -------
        list of State
            New states: of scans that waited for it, of a jump, or of a gap in the scans.

        Raises
        ------
        InvalidScan
            If the pose is invalid, or the stamp is not a finite number.
        """
        time, T = known_stamp(stamp), checked_pose(T_odom_base, "T_odom_base")
        jump = self._odometry.add(time, T)
        states = self._release(time) if jump is None else self._jumped(jump)
        if self._is_silent(time):
            self._fault = StateReason.NO_SCAN.format(seconds=time - self._newest)
            states.append(self._report(time))
        return states

    def add_height(self, stamp: float, height_m: float, sigma_m: float) -> list[State]:
        """Add an observed height of the base: of a barometer, or of the floor that a lift is at.

        It is one more likelihood of every hypothesis: it tells storeys apart that look alike. A
        wrong one is outweighed by scans; one that is older than ``height_s``, or without odometry
        at its time, is ignored.

        Parameters
        ----------
        stamp : float
            On the scans' clock [s].
        height_m, sigma_m : float
            Height in the map's frame, and its standard deviation [m].

        Returns
        -------
        list of State
            A new state if the status changes.

        Raises
        ------
        InvalidScan
            If a number is not finite, or the deviation is negative.
        """
        time, (height_m, sigma_m) = known_stamp(stamp), checked_height(height_m, sigma_m)
        T_odom_base, now = self._odometry.nearest(time), max(self._newest, self._odometry.newest)
        is_old = not abs(now - time) <= self.config.height_s
        is_out_of_order = time < self._height_at <= now
        if T_odom_base is None or is_old or is_out_of_order:
            self.unused_heights += 1
            return []
        self._height_at = time
        T_odom_sensor = T_odom_base @ self.T_base_sensor
        above = float(T_odom_sensor[2, 3] - T_odom_base[2, 3])
        self.tracker.observe_height(height_m + above, sigma_m, T_odom_sensor)
        is_news = self.tracker.track.status is not self.state.status
        return [self._report(self.state.stamp)] if is_news else []

    def add_scan(self, scan: Scan, stamp: float | None = None) -> list[State]:
        """Add a scan. It waits until odometry covers it.

        Parameters
        ----------
        scan : Scan
            Points in the sensor's frame; de-skewed if they have times, in seconds after the stamp.
        stamp : float, optional
            By default the scan's own [s].

        Returns
        -------
        list of State

        Raises
        ------
        InvalidScan
            If there is no stamp.
        """
        time = known_stamp(scan.stamp if stamp is None else stamp)
        scan = self._local_cloud.without_body(scan)  # before motion smears it
        if time <= self._newest:
            if self._newest - time <= self.config.clock_jump_s:
                self.dropped += 1
                return []
            self._set_clock(time)
        self._newest = time
        states = [] if self._lidar_odometry is None else self._register(scan, time)
        self._waiting.append((time, scan))
        states += self._release(time)
        while len(self._waiting) > self.config.waiting:
            del self._waiting[1]  # the first is the next that odometry may cover
            self.dropped += 1
        return states

    def due(self) -> QueryRequest | None:
        """Return the query to make now, if any; each once. A kept pose is checked there first."""
        request, self._due = self._due, None
        self._open = self._open or request is not None
        T_odom_base = self.state.T_odom_base
        if request is None or self.keeper is None or T_odom_base is None:
            return request
        near = self.keeper.near(request.stamp, T_odom_base, self.T_base_sensor)
        return replace(request, near=near)

    def ask(self, request: QueryRequest) -> QueryRequest:
        """Make a query, as :meth:`segloc.tracker.Tracker.ask` does; thread-safe.

        Raises
        ------
        SeglocError
            If it cannot be made.
        """
        return self.tracker.ask(request, self.config.deadline_ms)

    def answer(self, request: QueryRequest, made: QueryRequest | None) -> State:
        """Apply a query that was made; None if it could not be."""
        self._open = False
        if made is not None:
            self.tracker.take(made)
        return self._report(self.state.stamp, answered=request.stamp)

    def hurry(self) -> None:
        """Make a query due at the next scan, whatever time and distance."""
        self._asked_at = -math.inf

    def forget(self) -> State:
        """Forget the pose and the scans; the next scan triggers a query."""
        self.tracker.forget()
        self._due = None
        self.hurry()
        return self._report(self.state.stamp)

    def report_lost_motion(self, why: str) -> State:
        """Report that the odometry has lost an unknown motion without a jump of its poses."""
        return self._jumped(Jump(np.eye(4), why))[0]

    def report_silence(self, seconds: float) -> State:
        """Report that no data was received for some time, by the caller's clock."""
        self._fault = StateReason.NO_DATA.format(seconds=seconds)
        return self._report(self.state.stamp)

    # --- internal ------------------------------------------------------------------------------

    def _register(self, scan: Scan, stamp: float) -> list[State]:
        """Compute the odometry of a scan."""
        assert self._lidar_odometry is not None
        lost = self._lidar_odometry.losses
        states: list[State] = []
        for time, T in self._lidar_odometry.add(scan, stamp):
            states += self.add_odometry(time, T)
        if self._lidar_odometry.losses > lost:
            states.append(self.report_lost_motion(self._lidar_odometry.fault))
        return states

    def _release(self, now: float) -> list[State]:
        """Use the scans whose odometry is now known."""
        states = []
        while self._waiting:
            stamp, scan = self._waiting[0]
            first, last = span(scan, stamp)
            cover = self._odometry.cover(first, last, max(now, self._newest))
            if cover is Cover.LATER:
                break
            self._waiting.popleft()
            if cover is Cover.KNOWN:
                states.append(self._place(stamp, scan))
            else:
                self.dropped += 1
                self._fault = StateReason.NO_ODOMETRY.value
                states.append(self._report(stamp))
        return states

    def _place(self, stamp: float, scan: Scan) -> State:
        """De-skew a scan and pass it to the tracker."""
        motion = self._odometry.motion(self.T_base_sensor)
        T_odom_sensor = motion.at([stamp])[0]
        if abs(stamp - self._height_at) > self.config.height_s:
            self.tracker.forget_height()
        try:
            still = self._still(scan, motion, stamp)
            request = self.tracker.add(still, T_odom_sensor, due=self._is_due(stamp))
        except SeglocError as error:
            self.refused += 1
            self._fault = StateReason.REJECTED.format(error=error)
            return self._report(stamp)
        self.scans += 1
        self._fault = ""
        if request is not None:
            waits = self._due is not None and self._due.search  # behind a query that is slow
            self._asked_at = stamp
            self._due = replace(request, stamp=stamp, search=request.search or waits)
        return self._report(stamp, T_odom_sensor @ geometry.inverse(self.T_base_sensor))

    @staticmethod
    def _still(scan: Scan, motion: Motion, stamp: float) -> Scan:
        still = at_stamp(scan, motion, stamp)
        if still is scan:
            still = Scan(scan.points)
        still.stamp = stamp
        return still

    def _is_due(self, stamp: float) -> bool:
        """Return whether enough time has passed since the last query."""
        if self._open or self._due is not None:
            return False
        settled = self.state.status in (Status.LOCALIZED, Status.DEGRADED)
        every = self.config.every_s if settled else self.config.every_lost_s
        return stamp - self._asked_at >= every or stamp < self._asked_at

    def _jumped(self, jump: Jump) -> list[State]:
        self.jumps += 1
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._due = None
        self.tracker.follow_jump(jump.T_new_old, jump.text)
        newest = self._odometry.newest
        if newest == -math.inf:  # cleared with its clock
            newest = self.state.stamp if self._newest == -math.inf else self._newest
        return [self._report(newest)]

    def _set_clock(self, now: float) -> None:
        """Handle stamps that went back: drop waiting scans, and odometry of the other clock."""
        self.dropped += len(self._waiting)
        self._waiting.clear()
        if self._odometry.newest > now + self.config.clock_jump_s:
            self._odometry.clear()

    def _is_silent(self, now: float) -> bool:
        receiving = self._newest > -math.inf and not self._fault
        return receiving and now - self._newest > self.config.silent_s

    def _report(
        self, stamp: float, T_odom_base: Pose | None = None, answered: float | None = None
    ) -> State:
        """Return the current state; without odometry the pose is unknown."""
        track = self.tracker.track
        status, reason = track.status, track.reason
        if self._fault:
            reason = self._fault
            if status is Status.LOCALIZED:
                status = Status.DEGRADED
        if T_odom_base is None:
            T_odom_base, newest = self.state.T_odom_base, self._odometry.pose
            if stamp != self.state.stamp and newest is not None:
                T_odom_base = newest
        self.state = State(
            stamp,
            status,
            track.T_map_odom,
            T_odom_base,
            self._covariance(track.covariance),
            track.confidence,
            track.views,
            reason,
            self.tracker.travelled,
            answered,
        )
        T_map_base = self.state.T_map_base
        if self.keeper is not None and status is Status.LOCALIZED and T_map_base is not None:
            assert T_odom_base is not None
            self.keeper.keep(stamp, T_map_base, T_odom_base, self.state.covariance)
        return self.state

    def _covariance(self, covariance: Float64 | None) -> Float64 | None:
        """Convert the sensor's covariance to the base's, with a lower bound."""
        if covariance is None:
            return None
        least = np.repeat([math.radians(self.config.least_deg), self.config.least_m], 3) ** 2
        grown = geometry.carried_covariance(covariance, self.T_base_sensor) + np.diag(least)
        return np.asarray((grown + grown.T) / 2.0, dtype=np.float64)


RECORD = {
    "index": "number of the scan",
    "stamp": "time of the scan [s]; null if the recording has none",
    "state": "`lost`, `candidate`, `localized` or `degraded`",
    "reason": "why it is not localized; empty when localized",
    "T_map_odom": "4 rows of 4 numbers, or null; the odometry's frame begins at the first scan, "
    "level, and heads along x",
    "T_map_base": "4 rows of 4 numbers, or null; the base is the sensor",
    "covariance": "6 rows of 6 numbers, or null: covariance of `T_map_base`, of a small rotation "
    "[rad], then a translation [m], both in the base's frame",
    "confidence": "probability of the most probable place, 0 to 1",
    "views": "independent views that support it",
    "travelled_m": "distance by the odometry",
    "answered": "clock at the scan of the query that this state answers, or null",
    "latency_ms": "time from the arrival of that scan to this state",
    "correct": "with `--truth`: whether the pose is within the tolerance; else null",
}
"""Keys of a line of ``states.jsonl`` and their meaning."""


@dataclass(frozen=True)
class State:
    """Pose estimate of a robot.

    Attributes
    ----------
    stamp : float
        Of the newest scan or, between scans, of the newest odometry [s].
    status : Status
        ``lost``, ``candidate``, ``localized`` or ``degraded``.
    T_map_odom : (4, 4) float64 or None
        Takes poses of the odometry to the map; None while lost or candidate. Read-only.
    T_odom_base : (4, 4) float64 or None
        Pose of the base at ``stamp``, by the odometry. Read-only.
    covariance : (6, 6) float64 or None
        Of ``T_map_base``: of a small rotation [rad] and then a translation [m], both in the base's
        frame. :func:`segloc.ros_covariance` converts it for ROS. Read-only.
    confidence : float
        Probability of the most probable place, in [0, 1].
    views : int
        Independent views that agree.
    reason : str
        Why it is not localized; "" if it is.
    travelled_m : float
        Distance travelled, by odometry [m].
    answered : float or None
        Stamp of the query's scan if this state answers a query.
    latency_ms : float or None
        Time from the arrival of that scan, or of the newest one, to this state; None without a
        clock.
    """

    stamp: float
    status: Status
    T_map_odom: Pose | None = None
    T_odom_base: Pose | None = None
    covariance: Float64 | None = None
    confidence: float = 0.0
    views: int = 0
    reason: str = ""
    travelled_m: float = 0.0
    answered: float | None = None
    latency_ms: float | None = None

    def __post_init__(self) -> None:
        for array in (self.T_map_odom, self.T_odom_base, self.covariance):
            if array is not None:
                array.setflags(write=False)

    @property
    def localized(self) -> bool:
        """True if there is a pose: localized or degraded."""
        return self.T_map_odom is not None

    @property
    def T_map_base(self) -> Pose | None:
        """Pose of the base in the map, (4, 4) float64."""
        if self.T_map_odom is None or self.T_odom_base is None:
            return None
        return self.T_map_odom @ self.T_odom_base

    def record(self) -> Mapping[str, Any]:
        """Return values for JSON: those of ``RECORD`` that are of the state alone."""
        record = {name: getattr(self, name, None) for name in tuple(RECORD)[1:-1]}
        record["state"] = self.status.value
        return {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in record.items()}
