"""A robot followed, one event after another: no threads, no clock, so the same stream always gives
the same states."""

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
from ..localizer import Localizer
from ..motion import Motion, at_stamp
from ..prior import Prior
from ..system.checks import checked_pose
from ..tracker import QueryCallback, QueryRequest, Tracker
from ..tracking.belief import Status, View
from ..types import Float64, Pose, Scan
from .config import LiveConfig
from .kept_pose import PoseKeeper
from .lidar_odometry import LidarOdometry
from .odometry import Cover, Jump, Odometry, known_stamp, span

NO_ODOMETRY = "no odometry at the time of the scan"


@dataclass(frozen=True)
class Asked:
    """A query that is due.

    Attributes
    ----------
    stamp : float
        Of its scan.
    question : QueryRequest
    near : Prior or None
        Where the kept pose is checked.
    """

    stamp: float
    question: QueryRequest
    near: Prior | None = None


class LiveCore:
    """Takes scans and odometry in, and says after each where the robot is.

    Queries are not made here, since they take long: :meth:`due` hands one out, :meth:`ask` answers
    it and changes nothing, so that another thread may, and :meth:`answer` takes the answer in.

    Parameters
    ----------
    localizer : Localizer
    config : LiveConfig, optional
    T_base_sensor : (4, 4) array, optional
        How the sensor is mounted on the base that odometry is of; by default as
        ``local_cloud.mount`` says, and else the sensor is the base.
    lidar_odometry : bool
        Compute the odometry from the scans, by KISS-ICP; none is to be added then.
    keeper : PoseKeeper, optional
        Keeps the pose over a restart.

    Attributes
    ----------
    scans : int
        Placed by the odometry, and taken in.
    dropped : int
        Scans that were late, or that no odometry was known of.
    refused, jumps : int
        Scans that could not be used; jumps of the odometry.
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
        mount = localizer.config.local_cloud.mount.T_base_sensor
        given = np.eye(4) if mount is None else mount
        self.T_base_sensor = checked_pose(
            given if T_base_sensor is None else T_base_sensor, "T_base_sensor"
        )
        self.tracker = Tracker(localizer, self.config.tracker)
        self._keeper = keeper
        if keeper is not None:
            keeper.use(localizer.prior_map)
        self._lidar_odometry: LidarOdometry | None = None
        if lidar_odometry:
            attitude = localizer.config.local_cloud.attitude
            self._lidar_odometry = LidarOdometry(self.T_base_sensor, attitude)
        self.scans = self.dropped = self.refused = self.jumps = 0
        self._odometry = Odometry(self.config)
        self._waiting: deque[tuple[float, Scan]] = deque()
        self._newest = -math.inf  # stamp of the newest scan that came in
        self._asked_at = -math.inf
        self._due: Asked | None = None
        self._open = False  # whether a query is being made
        self._fault = ""  # why the track is not to be relied on, whatever the tracker says
        self.state = State(0.0, Status.LOST, reason="nothing has come in")

    # --- what comes in -------------------------------------------------------------------------

    def add_odometry(self, stamp: float, T_odom_base: ArrayLike) -> list[State]:
        """Take a pose of the odometry.

        Parameters
        ----------
        stamp : float
            Seconds, on the scans' clock.
        T_odom_base : (4, 4) array
            Pose of the base in the odometry's frame, whose z axis points up.

        Returns
        -------
        list of State
            What there is to say: of scans that have waited for it, of a jump, of silence.

        Raises
        ------
        InvalidScan
            If it is no pose, or the stamp is no finite number.
        """
        time, T = known_stamp(stamp), checked_pose(T_odom_base, "T_odom_base")
        jump = self._odometry.add(time, T)
        said = self._release(time) if jump is None else self._jumped(jump)
        if self._is_silent(time):
            self._fault = f"no scan for {time - self._newest:.1f} s"
            said.append(self._say(time))
        return said

    def add_scan(self, scan: Scan, stamp: float | None = None) -> list[State]:
        """Take a scan. It waits until the odometry is known all along it.

        Parameters
        ----------
        scan : Scan
            Points in the sensor's frame; with times, seconds after the stamp, its motion is undone.
        stamp : float, optional
            Seconds; by default the scan's own.

        Returns
        -------
        list of State

        Raises
        ------
        InvalidScan
            If there is no stamp.
        """
        time = known_stamp(scan.stamp if stamp is None else stamp)
        if time <= self._newest:
            if self._newest - time <= self.config.clock_jump_s:
                self.dropped += 1
                return []
            self._set_clock(time)
        self._newest = time
        said = [] if self._lidar_odometry is None else self._register(scan, time)
        self._waiting.append((time, scan))
        said += self._release(time)
        while len(self._waiting) > self.config.waiting:
            self._waiting.popleft()
            self.dropped += 1
        return said

    def due(self) -> Asked | None:
        """The query that is to be made now, if any; handed out once."""
        asked, self._due = self._due, None
        self._open = self._open or asked is not None
        T_odom_base = self.state.T_odom_base
        if asked is None or self._keeper is None or T_odom_base is None:
            return asked
        near = self._keeper.near(asked.stamp, T_odom_base, self.T_base_sensor)
        return replace(asked, near=near)

    def ask(
        self, asked: Asked, *, near: Prior | None = None, heard: QueryCallback | None = None
    ) -> View:
        """Make a query, as :meth:`segloc.Tracker.ask` does. It changes nothing: any thread may.

        Raises
        ------
        SeglocError
            If it cannot be made.
        """
        near = near or asked.near
        return self.tracker.ask(asked.question, self.config.deadline_ms, near=near, heard=heard)

    def answer(self, asked: Asked, view: View | None) -> State:
        """Take in what a query has said; None where it could not be made."""
        self._open = False
        if view is not None:
            self.tracker.take(asked.question, view)
        return self._say(self.state.stamp, answered=asked.stamp)

    def forget(self) -> State:
        """Forget where the robot is, not what was seen; with the next scan a query is due."""
        self.tracker.forget()
        self._asked_at, self._due = -math.inf, None
        return self._say(self.state.stamp)

    def doubt(self, why: str) -> State:
        """Take in that the odometry has lost an unknown motion, without a jump of its poses."""
        return self._jumped(Jump(np.eye(4), why))[0]

    def silent(self, seconds: float) -> State:
        """Say that nothing has come in for so long, by the clock of whoever listens."""
        self._fault = f"nothing has come in for {seconds:.1f} s"
        return self._say(self.state.stamp)

    # --- inside --------------------------------------------------------------------------------

    def _register(self, scan: Scan, stamp: float) -> list[State]:
        """Compute the odometry of a scan."""
        assert self._lidar_odometry is not None
        lost = self._lidar_odometry.losses
        said: list[State] = []
        for time, T in self._lidar_odometry.add(scan, stamp):
            said += self.add_odometry(time, T)
        if self._lidar_odometry.losses > lost:
            said.append(self.doubt(self._lidar_odometry.fault))
        return said

    def _release(self, now: float) -> list[State]:
        """Take in the scans whose odometry is known by now."""
        said = []
        while self._waiting:
            stamp, scan = self._waiting[0]
            first, last = span(scan, stamp)
            cover = self._odometry.cover(first, last, max(now, self._newest))
            if cover is Cover.LATER:
                break
            self._waiting.popleft()
            if cover is Cover.KNOWN:
                said.append(self._place(stamp, scan))
            else:
                self.dropped += 1
                self._fault = NO_ODOMETRY
                said.append(self._say(stamp))
        return said

    def _place(self, stamp: float, scan: Scan) -> State:
        """Undo a scan's motion and let the tracker have it."""
        motion = self._odometry.motion(self.T_base_sensor)
        T_odom_sensor = motion.at([stamp])[0]
        try:
            still = self._still(scan, motion, stamp)
            question = self.tracker.add(still, T_odom_sensor, due=self._is_due(stamp))
        except SeglocError as error:
            self.refused += 1
            self._fault = f"scan refused: {error}"
            return self._say(stamp)
        self.scans += 1
        self._fault = ""
        if question is not None:
            self._asked_at, self._due = stamp, Asked(stamp, question)
        return self._say(stamp, T_odom_sensor @ geometry.inverse(self.T_base_sensor))

    @staticmethod
    def _still(scan: Scan, motion: Motion, stamp: float) -> Scan:
        still = at_stamp(scan, motion, stamp)
        if still is scan:
            still = Scan(scan.points)
        still.stamp = stamp
        return still

    def _is_due(self, stamp: float) -> bool:
        """Whether so long ago a query was made that it is time for the next."""
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
        self.tracker.carry(jump.T_new_old, jump.text)
        return [self._say(self._odometry.newest)]

    def _set_clock(self, now: float) -> None:
        """Stamps have gone back: what waits, and odometry of the other clock, is of no use."""
        self.dropped += len(self._waiting)
        self._waiting.clear()
        if self._odometry.newest > now + self.config.clock_jump_s:
            self._odometry.clear()

    def _is_silent(self, now: float) -> bool:
        heard = self._newest > -math.inf and not self._fault
        return heard and now - self._newest > self.config.silent_s

    def _say(
        self, stamp: float, T_odom_base: Pose | None = None, answered: float | None = None
    ) -> State:
        """What is known now. Nothing is believed of a robot of which no odometry is known."""
        track = self.tracker.track
        status, reason = track.status, track.reason
        if self._fault:
            reason = self._fault
            if status is Status.LOCALIZED:
                status = Status.DEGRADED
        if T_odom_base is None:
            T_odom_base = self.state.T_odom_base if stamp == self.state.stamp else self._last_pose()
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
        if self._keeper is not None and status is Status.LOCALIZED and T_map_base is not None:
            assert T_odom_base is not None
            self._keeper.keep(stamp, T_map_base, T_odom_base, self.state.covariance)
        return self.state

    def _last_pose(self) -> Pose | None:
        pose = self._odometry.pose
        return self.state.T_odom_base if pose is None else pose

    def _covariance(self, covariance: Float64 | None) -> Float64 | None:
        """Of the base's pose, from that of the sensor's, and never less than is to be believed."""
        if covariance is None:
            return None
        least = np.repeat([math.radians(self.config.least_deg), self.config.least_m], 3) ** 2
        grown = geometry.carried_covariance(covariance, self.T_base_sensor) + np.diag(least)
        return np.asarray((grown + grown.T) / 2.0, dtype=np.float64)


@dataclass(frozen=True)
class State:
    """Pose estimate of a robot, and its certainty.

    Attributes
    ----------
    stamp : float
        Of the newest scan or, between scans, of the newest odometry; seconds.
    status : Status
        ``lost``, ``candidate``, ``localized`` or ``degraded``.
    T_map_odom : (4, 4) float64 or None
        Takes poses of the odometry to the map; None while lost or candidate. Read-only.
    T_odom_base : (4, 4) float64 or None
        Where the base was at ``stamp``, by the odometry. Read-only.
    covariance : (6, 6) float64 or None
        Of ``T_map_base``: of a small rotation (rad) and then a translation (m), both in the base's
        frame. :func:`segloc.ros_covariance` gives ROS's. Read-only.
    confidence : float
        Probability of the likeliest place, in [0, 1].
    views : int
        Independent views that agree.
    reason : str
        Why it is not localized; "" if it is.
    travelled_m : float
        Distance travelled, by odometry [m].
    answered : float or None
        Stamp of the query's scan if this state answers a query.
    latency_ms : float or None
        From the arrival of that scan, or of the newest, to this state; None without a clock.
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
        """Whether there is a pose: localized or degraded."""
        return self.T_map_odom is not None

    @property
    def T_map_base(self) -> Pose | None:
        """Where the base is in the map, (4, 4) float64."""
        if self.T_map_odom is None or self.T_odom_base is None:
            return None
        return self.T_map_odom @ self.T_odom_base

    def record(self) -> Mapping[str, Any]:
        """Values for JSON."""
        return {
            "stamp": self.stamp,
            "state": self.status.value,
            "reason": self.reason,
            "T_map_odom": _nested(self.T_map_odom),
            "T_map_base": _nested(self.T_map_base),
            "covariance": _nested(self.covariance),
            "confidence": self.confidence,
            "views": self.views,
            "travelled_m": self.travelled_m,
            "answered": self.answered,
            "latency_ms": self.latency_ms,
        }


def _nested(array: Float64 | None) -> list[list[float]] | None:
    return None if array is None else np.asarray(array).tolist()
