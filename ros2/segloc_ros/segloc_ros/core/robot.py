"""The node without ROS: it takes messages and returns replies to publish.

No threads, and no clock but for durations. As with :class:`segloc.live.LiveCore`, which this wraps,
queries are returned, made by the caller, and applied.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from segloc import InvalidScan, Localization, Localizer, Prior, Scan, SeglocError, geometry
from segloc.live import LidarOdometry, LiveCore, QueryRequest, State, Status
from segloc.robot import (
    Float64,
    Pose,
    StreamTimes,
    matched_segments,
    prior_of_fix,
    scan_of_pointcloud2,
    unread_times,
)

from .body import Body, Stamped, same
from .clicks import Click, Echoes
from .frames import Transform, frame_name
from .livox import livox_cloud
from .maps import MapFile
from .merge import MountedScan
from .replies import (
    CandidatesReply,
    InitialPose,
    MapToOdom,
    MatchesReply,
    OdometryReply,
    PoseReply,
    Reply,
)
from .scan_checks import ScansInOdom, StillClouds
from .settings import Settings
from .trigger import Trigger

_MOST_POSES = 4096
_NEAR_S = 0.5
_MOVED = geometry.Separation(metres=1.0, degrees=5.0, height=1.0)
"""A tracker gets another pose if its own differs by more."""


class Robot:
    """Localizes a robot from the messages of its topics.

    Attributes
    ----------
    faults : dict of str to str
        Messages on what is missing, by kind; no pose is published while there is any.
    core : LiveCore or None
        What follows the robot; None while the map or the mount is unknown.
    state : State or None
    fixes : int
        How often it was found.
    last : Localization or None
        Answer of the last search.
    intake_ms, points : float, int
        Processing time of the last cloud, and its points, those of all LiDARs.
    refused : Counter of str
        Clouds that were not used, by reason.
    skipped, behind_s : int, float
        As for :class:`segloc.live.Shell`, which sets them.
    jumps : int
        Jumps of the odometry.
    publishers : int or None
        Of ``points``; None if unknown.
    point_times : dict of str to StreamTimes
        Unit of the point times by topic; ``note`` is a line if they are converted or dropped.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.body = Body(settings)
        self.trigger = Trigger(settings.trigger, settings.click_s)
        self.state: State | None = None
        self.last: Localization | None = None
        self.fixes, self.intake_ms, self.points = 0, 0.0, 0
        self.refused: Counter[str] = Counter()
        self.skipped = self.jumps = 0
        self.behind_s = 0.0
        self.maps = MapFile(settings.map, settings.threads)
        self.publishers: int | None = None
        self._arrived: float | None = None  # when the last cloud came, by a steady clock
        self._heard_at = np.inf  # when the last cloud or odometry came
        self._localizer: Localizer | None = None
        self._fix: Any = None  # the newest sensor_msgs/NavSatFix
        self._is_near_fix = False  # whether the last query was near it
        self.core: LiveCore | None = None
        self._asked: LiveCore | None = None  # that the query in progress is of
        self.point_times: defaultdict[str, StreamTimes] = defaultdict(StreamTimes)
        self._own = {"points": f"no cloud yet: {settings.points_topic}"}
        self.keeper = settings.keeper
        self._smooth, self._merger = settings.smooth, settings.merger
        self._lidar_odometry: LidarOdometry | None = None
        self._registered_at = -np.inf  # stamp of the newest cloud that odometry was computed of
        self._lidar = "", -np.inf  # frame and stamp of the newest cloud of the main topic
        self._unread: dict[str, str] = {}  # fields that look like point times, by topic
        self._still, self._checked = StillClouds(), ScansInOdom()
        self._tf_changes = 0
        self._odometry: deque[Stamped] = deque(maxlen=_MOST_POSES)
        self._echoes = Echoes()
        self._jumps, self._sent_at = 0, -np.inf
        self._live = settings.live
        self._same_clock_s = self._live.silent_s + self._live.clock_jump_s
        self._kept: Pose | None = None  # the last T_map_odom, broadcast while the robot is lost
        self._posed_at = -np.inf  # stamp of the last pose published
        self._told: Pose | None = None  # T_map_odom that the tracker has
        self._supposed: Pose | None = None  # T_map_odom of a map that was switched to

    @property
    def faults(self) -> dict[str, str]:
        known = {**self._own, **self.body.faults}
        return known if self._localizer is not None else {**known, "map": self.maps.missing}

    @property
    def hint(self) -> str:
        """Likely cause of failed queries; "" if none is known."""
        return self._checked.fault

    @property
    def stamp(self) -> float:
        """Stamp of the newest odometry [s]; 0 before the first."""
        return self._odometry[-1][0] if self._odometry else 0.0

    @property
    def lacks_odometry(self) -> bool:
        """Whether odometry has ended while clouds go on."""
        return self._lidar[1] - self.stamp > self._live.silent_s

    @property
    def cloud_age_s(self) -> float | None:
        """Time since the newest cloud arrived [s]; None before the first."""
        return None if self._arrived is None else time.monotonic() - self._arrived

    @property
    def time_notes(self) -> str:
        """Assumed units of point times, or why they are not used."""
        notes = {*self._unread.values(), *(each.note for each in self.point_times.values())}
        return "; ".join(sorted(notes - {""}))

    # --- inputs --------------------------------------------------------------------------------

    def use(self, localizer: Localizer) -> None:
        """Take a map, the first or another: the pose in the one before is forgotten."""
        self._localizer = localizer
        self._end()
        self._kept = None

    def switch(self, localizer: Localizer, T_new_old: Pose | None = None) -> None:
        """Take another map and search it.

        With ``T_new_old``, between the maps' frames, the last pose is supposed there until views
        confirm it, and it is searched near that pose first, seen from above.
        """
        pose, prior = self._now(), None
        self.use(localizer)
        if T_new_old is not None and pose is not None:
            T_map_base = T_new_old @ pose[0]
            prior = Prior(T_map_base[:2, 3], self.settings.click_radius_m)
            self._supposed = T_map_base @ geometry.inverse(pose[1])
            self._kept = self._supposed if self.settings.tf_when_lost == "keep" else None
        self.relocalize(prior)

    def on_transforms(self, transforms: list[Transform], static: bool) -> list[Reply]:
        """tf2_msgs/TFMessage. A mount that moves ends the localization."""
        odometry = self.body.add_transforms(transforms, static)
        if self.body.tf_changes != self._tf_changes:
            self._tf_changes = self.body.tf_changes
            if self.core is not None and not self.body.is_rigid():
                self._end()
        return self._moved(odometry)

    def on_odometry(self, stamp: float, parent: str, child: str, T: Pose) -> list[Reply]:
        """nav_msgs/Odometry."""
        return self._moved(self.body.add_odometry(stamp, parent, child, T))

    def on_acceleration(self, stamp: float, frame: str, acceleration: Float64) -> list[Reply]:
        """sensor_msgs/Imu; one that is not finite is ignored."""
        if np.isfinite(acceleration).all():
            self.body.add_acceleration(stamp, frame, acceleration)
        return []

    def on_cloud(self, cloud: Any, stamp: float, frame: str, topic: str = "") -> list[Reply]:
        """sensor_msgs/PointCloud2. An unusable one is refused, counted by reason, and reported.

        ``topic``: of which LiDAR it is, if there are several.
        """
        names = [field.name for field in cloud.fields]
        return self._on_scan(lambda: scan_of_pointcloud2(cloud), names, stamp, frame, topic)

    def on_livox(self, data: bytes, topic: str = "") -> list[Reply]:
        """livox_ros_driver2/CustomMsg, serialised; otherwise as :meth:`on_cloud`."""
        try:
            stamp, frame, scan = livox_cloud(data)
        except SeglocError as error:
            self._arrived = self._heard_at = time.monotonic()
            return self._refuse("unreadable", f"cloud refused: {error}")
        return self._on_scan(lambda: scan, [], stamp, frame, topic)

    def report_topic(self, fault: str) -> None:
        """Report that clouds of a topic cannot be received."""
        self._own["points"] = fault

    def _on_scan(
        self, read: Callable[[], Scan], names: list[str], stamp: float, frame: str, topic: str
    ) -> list[Reply]:
        """Take a cloud; ``names`` are those of its fields."""
        begun = time.perf_counter()
        self._arrived = self._heard_at = time.monotonic()
        self._own.pop("points", None)
        lidar, topic = frame_name(frame), topic or self.settings.points_topic
        if topic == self.settings.points_topic and not self._is_of_one(lidar, stamp):
            return []
        T_base_lidar = self.body.mount(lidar, topic)
        if T_base_lidar is None:
            self.refused[self.body.refusal] += 1
            if self.body.is_broken(lidar, topic):
                self._end()
            return []
        try:
            scan = read()
        except SeglocError as error:
            return self._refuse("unreadable", f"cloud refused: {error}")
        if not len(scan):
            unusable = "cloud refused: no points, or all are zero or not finite: check the driver"
            return self._refuse("no usable points", unusable)
        if topic not in self._unread:
            self._unread[topic] = unread_times(names)
        given = MountedScan(stamp, self.point_times[topic].apply(scan, stamp), T_base_lidar)
        replies: list[Reply] = []
        for each in self._merged(topic, given):
            replies += self._take(each)
        self.intake_ms = 1e3 * (time.perf_counter() - begun)
        return replies

    def _refuse(self, reason: str, fault: str) -> list[Reply]:
        self.refused[reason] += 1
        self._own["points"] = fault
        return []

    def _is_of_one(self, lidar: str, stamp: float) -> bool:
        """Return whether clouds of the main topic are of one LiDAR."""
        name, last = self._lidar
        if lidar != name and 0.0 <= stamp - last < self.settings.silent_s:
            fault = f"clouds in {lidar} and in {name} on one topic: use more_points_topics"
            self._refuse("several frames", fault)
            return False
        self._lidar = lidar, stamp
        return True

    def _merged(self, topic: str, given: MountedScan) -> list[MountedScan]:
        if self._merger is None:
            return [given]
        merged = self._merger.add(topic, given)
        if merged and self._merger.missing:
            self._own["points"] = f"no clouds of {', '.join(self._merger.missing)}"
        return merged

    def _take(self, given: MountedScan) -> list[Reply]:
        if fault := self._stands_still(given):
            self._end()
            return self._refuse("world frame", fault)
        core, self.points = self._following(given.T_base_sensor), len(given.scan)
        replies: list[Reply] = []
        try:
            if self.settings.odometry == "none":
                self._moved(self.body.standing(given.stamp))
                given.scan.times = None
            elif self.settings.odometry == "kiss-icp":
                replies += self._registered(given)
            if core is not None:
                replies += self._tell(core.add_scan(given.scan, given.stamp))
        except SeglocError as error:
            self._refuse("unusable", f"cloud refused: {error}")
        return replies

    def _stands_still(self, given: MountedScan) -> str:
        """Return the fault of clouds in a fixed frame; "" for others."""
        T_odom_base = self._pose_near(given.stamp)
        if T_odom_base is None:
            return ""
        T_odom_lidar = T_odom_base @ given.T_base_sensor
        self._still.add(given.scan.points, T_odom_lidar)
        if not (self.state is not None and self.state.localized):
            self._checked.add(given.scan, T_odom_lidar)
        if not self._still.still_m or self.settings.odometry == "kiss-icp":
            return ""  # odometry of the clouds needs them
        return (
            f"clouds stand still while the odometry moves {self._still.still_m:.1f} m: they are "
            "in the odometry's frame (use the driver's raw topic), or the robot did not move"
        )

    def _pose_near(self, stamp: float) -> Pose | None:
        """Return the pose of the odometry nearest to a time; None if there is none within 0.5 s."""
        nearest_s, nearest = _NEAR_S, None
        for time_s, T in reversed(self._odometry):
            if (off_s := abs(time_s - stamp)) <= nearest_s:
                nearest_s, nearest = off_s, T
            elif nearest is not None:
                break
        return nearest

    def on_fix(self, fix: Any) -> list[Reply]:
        """sensor_msgs/NavSatFix."""
        self._fix = fix
        return []

    def on_height(self, stamp: float, frame: str, metres: float, variance: float) -> list[Reply]:
        """geometry_msgs/PoseWithCovarianceStamped, of which z and its variance count.

        Raises
        ------
        InvalidScan
            If a number is not finite, the variance is negative, or the frame is not the map's.
        """
        if frame_name(frame) != self.settings.map_frame:
            raise InvalidScan(
                f"height ignored: its frame is {frame or 'empty'}, not {self.settings.map_frame}"
            )
        if not 0.0 <= variance < np.inf:
            raise InvalidScan(f"height ignored: its variance is {variance}, not 0 m2 or more")
        sigma_m = float(np.sqrt(variance)) or self.settings.height_sigma_m
        return [] if self.core is None else self._tell(self.core.add_height(stamp, metres, sigma_m))

    def on_click(self, click: Click) -> str:
        """Take a rough pose: forget the current one and search near it.

        Returns
        -------
        str
            Why it is ignored; "" if it is used.
        """
        if self._echoes.holds(click.T_map_base):
            return "an echo"
        if frame_name(click.frame) != self.settings.map_frame:
            return f"its frame is {click.frame or 'empty'}, not {self.settings.map_frame}"
        self.relocalize(click.prior(self.settings.click_radius_m))
        return ""

    def relocalize(self, near: Prior | None = None, anywhere: bool = True) -> int:
        """Forget the pose and search at the next cloud, without motion of the robot.

        Returns
        -------
        int
            ``fixes`` exceeds it once the robot is found.
        """
        if self.keeper is not None:
            self.keeper.drop("overridden by a call")
        self.trigger.wake(near, anywhere)
        self._told, self._own = None, {k: v for k, v in self._own.items() if k != "jump"}
        self._forget_hints()
        if self.core is not None:
            self.state = self.core.forget()
        return self.fixes

    def request_update(self) -> None:
        """Query at the next cloud although the robot does not move; the pose stays.

        A robot that is at rest checks its pose, and rests again. One that rests without a pose
        ignores it.
        """
        if self.trigger.resting and self.trigger.held is None:
            return
        self.trigger.check()
        if self.core is not None:
            self.core.hurry()

    def report_silence(self) -> list[Reply]:
        """Report, once, that neither clouds nor odometry came for some time."""
        silent_s = time.monotonic() - self._heard_at
        if self.core is None or not self.core.scans or silent_s <= self.settings.silent_s:
            return []
        self._heard_at = np.inf
        return self._tell([self.core.report_silence(silent_s)])

    # --- queries -------------------------------------------------------------------------------

    def due(self) -> QueryRequest | None:
        """Return the query to make now, if any."""
        core = self.core
        if core is None or (request := core.due()) is None:
            return None
        near = self.trigger.near(request.stamp) or request.near or self._fixed(request.stamp)
        if self.trigger.resting:
            core.answer(request, None)
            return None
        self._asked = core
        return replace(request, near=near)

    def _fixed(self, stamp: float) -> Prior | None:
        """Return a prior around the newest fix, in every other query while not localized."""
        is_wanted = self._fix is not None and self.state is not None and not self.state.localized
        if self._localizer is None or not is_wanted:
            return None
        self._own.pop("fix", None)
        try:
            least_m = self.settings.click_radius_m
            prior = prior_of_fix(self._localizer.prior_map, self._fix, stamp, least_m)
        except SeglocError as error:
            self._own["fix"] = f"GNSS unused: {error}"
            return None
        if prior is None:  # the receiver has none
            return None
        # The whole map has a query, and a deadline, of its own.
        self._is_near_fix = not self._is_near_fix
        return replace(prior, anywhere=False) if self._is_near_fix else None

    def ask(self, request: QueryRequest) -> QueryRequest:
        """Make a query; thread-safe."""
        assert self._asked is not None
        checked, made = self._checked, self._asked.ask(request)
        if made.found is not None:
            checked.check(failed=not made.found[2].localized)
        return made

    def answer(self, request: QueryRequest, made: QueryRequest | None) -> list[Reply]:
        """Apply a query; one in a map that was replaced meanwhile is ignored."""
        core, frame = self.core, self.settings.map_frame
        if core is None or core is not self._asked:
            return []
        if made is None or made.found is None:
            return self._tell([core.answer(request, made)])
        query, search, self.last = made.found
        replies = self._tell([core.answer(request, made)])
        T_sensor_base = geometry.inverse(core.T_base_sensor)
        places = [(p.T_map_sensor @ T_sensor_base, p.probability) for p in self.last.places]
        if places:
            replies.append(CandidatesReply(request.stamp, frame, tuple(places)))
        position, centroids = matched_segments(query, search)
        if self.settings.matches and position is not None:
            shown = position, centroids, search.reason is None
            replies.append(MatchesReply(request.stamp, frame, *shown))
        return replies

    # --- state ---------------------------------------------------------------------------------

    @property
    def pose_state(self) -> State | None:
        """The state of the current pose: the one that was found before rest, else the newest.

        The one before rest counts, too, until a query that checks it gives another.
        """
        state, held = self.state, self.trigger.held
        is_lost = state is None or state.T_map_odom is None
        return held if self.trigger.resting or (is_lost and held is not None) else state

    @property
    def T_map_odom(self) -> Pose | None:
        """(4, 4) float64; None while it is not localized."""
        current = self.pose_state
        if current is None or current.T_map_odom is None:
            return None
        return current.T_map_odom @ self.body.T_level_odom

    @property
    def keeps_tf(self) -> bool:
        """Whether the last map -> odom is broadcast although the robot is lost."""
        return self.settings.broadcasts_tf and self.T_map_odom is None and self._kept is not None

    def initial_pose(self) -> InitialPose | None:
        """Return the pose for a tracker; None while the robot is not localized."""
        now = self._now()
        if now is None:
            return None
        assert self.state is not None
        T, T_odom_base, covariance = now
        self._told = T @ geometry.inverse(T_odom_base)
        self._echoes.sent(T)
        least = (self.settings.initialpose_least_m, self.settings.initialpose_least_deg)
        frame = self.settings.map_frame
        return InitialPose(PoseReply.of(self.state.stamp, frame, T, covariance, least))

    # --- inside --------------------------------------------------------------------------------

    def _end(self) -> None:
        """End the localization: forget the pose and the scans."""
        self.core, self.state, self._told = None, None, None
        self._forget_hints()
        if self._smooth is not None:
            self._smooth.clear()
        if self.trigger.held is not None:
            self.trigger.lose()

    def _forget_hints(self) -> None:
        self._checked = ScansInOdom()

    def _following(self, T_base_lidar: Pose) -> LiveCore | None:
        """Return the core for a mount; a new one if it has changed."""
        if self._localizer is None:
            return None
        if self.core is None or not same(self.core.T_base_sensor, T_base_lidar):
            self.core = LiveCore(self._localizer, self._live, T_base_lidar, keeper=self.keeper)
            self.state, self._told = None, None
            for stamp, T in self._odometry:
                self.core.add_odometry(stamp, T)
            self._jumps = self.core.jumps
            if self._supposed is not None:
                self.core.tracker.suppose(self._supposed)
                self._supposed = None
        return self.core

    def _moved(self, odometry: list[Stamped]) -> list[Reply]:
        replies: list[Reply] = []
        for stamp, T in odometry:
            self._heard_at = time.monotonic()
            self._odometry.append((stamp, T))
            if self.core is not None:
                replies += self._tell(self.core.add_odometry(stamp, T))
            replies += self._broadcast(stamp, T)
        return replies

    def _registered(self, given: MountedScan) -> list[Reply]:
        """Compute the odometry of a cloud, and publish it."""
        if 0.0 <= self._registered_at - given.stamp <= self._live.clock_jump_s:
            return []  # late or repeated, as for the core
        self._registered_at, odometry = given.stamp, self._lidar_odometry
        if odometry is None or not same(odometry.T_base_sensor, given.T_base_sensor):
            odometry = self._lidar_odometry = LidarOdometry(given.T_base_sensor)
        lost, replies, scan = odometry.losses, list[Reply](), given.scan
        if self._localizer is not None:
            scan = self._localizer.config.local_cloud.without_body(scan)
        for time_s, T in odometry.add(scan, given.stamp):
            before = self._odometry[-1] if self._odometry else None
            if before is not None and 0.0 <= before[0] - time_s <= self._live.clock_jump_s:
                continue
            frames = self.body.odom_frame, self.settings.base_frame
            replies.append(OdometryReply.of(Transform(time_s, *frames, T), before))
            replies += self._moved(self.body.computed(time_s, T))
        if odometry.losses > lost and self.core is not None:
            replies += self._tell([self.core.report_lost_motion(odometry.fault)])
        return replies

    def _broadcast(self, stamp: float, T_odom_base: Pose) -> list[Reply]:
        settings, current = self.settings, self.pose_state
        T = None if current is None else current.T_map_odom
        if settings.tf_when_lost == "keep":
            T = self._kept = self._kept if T is None else T
        if T is None and self._smooth is not None:
            self._smooth.clear()
        if T is None or not settings.broadcasts_tf:
            return []
        if 0.0 <= stamp - self._sent_at < 1.0 / settings.tf_rate_hz:
            return []
        self._sent_at = stamp
        if self._smooth is not None:
            T = self._smooth.update(stamp, T, T_odom_base)
        T = T @ self.body.T_level_odom
        ahead = stamp + settings.tf_ahead_s
        return [MapToOdom(Transform(ahead, settings.map_frame, self.body.odom_frame, T))]

    def _tell(self, states: list[State]) -> list[Reply]:
        replies: list[Reply] = []
        for state in states:
            self.state = state
            self._notice_jumps()
            if not self.trigger.resting:
                replies += self._replies_of(state)
            elif self.keeper is not None and (pose := self._now()) is not None:
                self.keeper.keep(state.stamp, *pose)
        return replies

    def _now(self) -> tuple[Pose, Pose, Float64 | None] | None:
        """T_map_base, T_odom_base, and the covariance when it was measured."""
        current, state = self.pose_state, self.state
        if state is None or current is None or current.T_map_odom is None:
            return None
        if state.T_odom_base is None:
            return None
        return current.T_map_odom @ state.T_odom_base, state.T_odom_base, current.covariance

    def _notice_jumps(self) -> None:
        core = self.core
        if core is None or core.jumps == self._jumps:
            return
        self.jumps += core.jumps - self._jumps
        self._jumps, self._still = core.jumps, StillClouds()
        self._kept = None  # that of the odometry before
        if self._smooth is not None:
            self._smooth.clear()
        if self.trigger.held is not None:
            self.trigger.lose()
            self._told, self.state = None, core.forget()
            if self.trigger.resting:
                self._own["jump"] = "the odometry jumped: call ~/relocalize"

    def _replies_of(self, state: State) -> list[Reply]:
        replies: list[Reply] = []
        if state.answered is None and self._posed_at - state.stamp > self._live.clock_jump_s:
            self._posed_at = -np.inf  # of another clock
        # Once a stamp: a query that corrects a pose corrects that of the next cloud.
        is_new = not 0.0 <= self._posed_at - state.stamp <= self._same_clock_s
        if is_new and (pose := self._published(state)) is not None:
            self._posed_at = state.stamp
            replies.append(PoseReply.of(state.stamp, self.settings.map_frame, *pose))
        if not state.localized:
            self._told = None
        elif state.status is Status.LOCALIZED and self._is_news(state):
            self.fixes += 1
            told = self.initial_pose()
            if self.settings.sends_initialpose and told is not None:
                replies.append(told)
            self.trigger.found(state)
        elif state.status is Status.LOCALIZED and state.answered is not None:
            self.trigger.found(state)
        return replies

    def _published(self, state: State) -> tuple[Pose, Float64 | None] | None:
        """T_map_base and covariance, consistent with map -> odom where that is smooth."""
        if self._pose_near(state.stamp) is None:  # T_odom_base is of another time
            return None
        T, T_odom_base = state.T_map_base, state.T_odom_base
        smooth = None if self._smooth is None else self._smooth.T_map_odom
        if T is None or T_odom_base is None or state.T_map_odom is None:
            return None
        if self._smooth is None or smooth is None or state.covariance is None:
            return T, state.covariance
        offset = self._smooth.offset(state.T_map_odom, T_odom_base)
        return smooth @ T_odom_base, state.covariance + np.outer(offset, offset)

    def _is_news(self, state: State) -> bool:
        """Return whether the pose that the tracker has is now wrong."""
        if self._told is None or state.T_odom_base is None or state.T_map_base is None:
            return True
        return _MOVED.apart(self._told @ state.T_odom_base, state.T_map_base)
