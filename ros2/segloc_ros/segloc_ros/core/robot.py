"""The node without ROS: what topics say goes in, what is to be published comes out.

No threads and no clock but for durations. Queries are handed out, made elsewhere, and answered, as
with :class:`segloc.live.LiveCore`, around which this is.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from dataclasses import replace
from typing import Any

import numpy as np

from segloc import Localizer, Prior, SeglocError, geometry
from segloc.batch.run import gnss_priors
from segloc.datasets.clocks import StreamTimes
from segloc.datasets.fixes import Fixes
from segloc.datasets.ros.pointcloud2 import to_scan
from segloc.live import LidarOdometry, LiveCore, MountedScan, State, Status
from segloc.map.georeference import Georeference
from segloc.types import Float64, Pose

from .body import Body, Stamped, same
from .clicks import Click, Echoes
from .frames import Transform, frame_name
from .queries import Answer, Job, make
from .replies import CandidatesReply, InitialPose, MapToOdom, OdometryReply, PoseReply, Reply
from .settings import Settings
from .trigger import Trigger

_MOST_POSES = 4096
_MOVED = geometry.Separation(metres=1.0, degrees=5.0, height=1.0)
"""A tracker is told again where it is once that differs by more."""


class Robot:
    """Where a robot is, from what its topics say.

    Parameters
    ----------
    settings : Settings

    Attributes
    ----------
    faults : dict of str to str
        What is missing, in words, by kind; nothing is told of the robot while there is any.
    state : State or None
    fixes : int
        How often it was found.
    last : Answer or None
        The last query with a search.
    intake_ms, points : float, int
        What the last cloud took, and its points, those of all LiDARs.
    keeper : PoseKeeper or None
        Keeps the pose over a power cycle.
    point_times : dict of str to StreamTimes
        Unit of the point times by topic; ``note`` tells what is converted or dropped.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.body = Body(settings)
        self.trigger = Trigger(settings.trigger, settings.click_s)
        self.state: State | None = None
        self.last: Answer | None = None
        self.fixes, self.intake_ms, self.points = 0, 0.0, 0
        self._localizer: Localizer | None = None
        self._fix: Any = None  # the newest sensor_msgs/NavSatFix
        self._is_near_fix = False  # whether the last query was near it
        self._core: LiveCore | None = None
        self.point_times: defaultdict[str, StreamTimes] = defaultdict(StreamTimes)
        self._own = {
            "map": "the map is being read",
            "points": f"no cloud yet: {settings.points_topic}",
        }
        self.keeper = settings.keeper
        self._smooth, self._merger = settings.smooth, settings.merger
        self._lidar_odometry: LidarOdometry | None = None
        self._lidar = "", -np.inf  # whose clouds are taken, and when the last came
        self._odometry: deque[Stamped] = deque(maxlen=_MOST_POSES)
        self._echoes = Echoes()
        self._jumps, self._sent_at = 0, -np.inf
        self._told: Pose | None = None  # T_map_odom that a tracker has, or nothing is believed

    @property
    def faults(self) -> dict[str, str]:
        return {**self._own, **self.body.faults}

    @property
    def core(self) -> LiveCore | None:
        """What follows the robot; None while the map or the mount is unknown."""
        return self._core

    # --- what comes in -------------------------------------------------------------------------

    def use(self, localizer: Localizer) -> None:
        """Take a map, the first or another: what was known of the one before is forgotten."""
        self._localizer, self._core, self.state, self._told = localizer, None, None, None
        if self.trigger.held is not None:
            self.trigger.lose()
        self._own.pop("map", None)

    def switch(self, localizer: Localizer, T_new_old: Pose | None = None) -> None:
        """Take another map and search it.

        With ``T_new_old``, between the maps' frames, near the last pose first, seen from above.
        """
        pose = self._now()
        self.use(localizer)
        prior = None
        if T_new_old is not None and pose is not None:
            prior = Prior((T_new_old @ pose[0])[:2, 3], self.settings.click_radius_m)
        self.relocalize(prior)

    def no_map(self, why: str) -> None:
        """There is none; one that was used before stays in use."""
        if self._localizer is None:
            self._own["map"] = why

    def on_transforms(self, transforms: list[Transform], static: bool) -> list[Reply]:
        """tf2_msgs/TFMessage."""
        return self._moved(self.body.add_transforms(transforms, static))

    def on_odometry(self, stamp: float, parent: str, child: str, T: Pose) -> list[Reply]:
        """nav_msgs/Odometry."""
        return self._moved(self.body.add_odometry(stamp, parent, child, T))

    def on_acceleration(self, stamp: float, frame: str, acceleration: Float64) -> None:
        """sensor_msgs/Imu; none where the driver says that it has none."""
        if np.isfinite(acceleration).all():
            self.body.add_acceleration(stamp, frame, acceleration)

    def on_cloud(self, cloud: Any, stamp: float, frame: str, topic: str = "") -> list[Reply]:
        """sensor_msgs/PointCloud2. What cannot be used is refused, and that is said.

        ``topic``: of which LiDAR it is, if there are several.
        """
        begun = time.perf_counter()
        self._own.pop("points", None)
        lidar, is_main = frame_name(frame), topic in ("", self.settings.points_topic)
        if is_main and not self._is_of_one(lidar, stamp):
            return []
        T_base_lidar = self.body.mount(lidar)
        if T_base_lidar is None:
            return []
        replies: list[Reply] = []
        try:
            name = topic or self.settings.points_topic
            scan = self.point_times[name].apply(to_scan(cloud), stamp)
            given = [MountedScan(stamp, scan, T_base_lidar)]
            if self._merger is not None:
                given = self._merger.add(name, given[0])
                if given and self._merger.missing:
                    self._own["points"] = f"no clouds of {', '.join(self._merger.missing)}"
            for each in given:
                replies += self._take(each)
        except SeglocError as error:
            if self._core is not None:
                self._core.refused += 1
            self._own["points"] = f"cloud refused: {error}"
            return []
        self.intake_ms = 1e3 * (time.perf_counter() - begun)
        return replies

    def _is_of_one(self, lidar: str, stamp: float) -> bool:
        """Whether clouds of the main topic are of one LiDAR."""
        name, last = self._lidar
        if lidar != name and 0.0 <= stamp - last < self.settings.silent_s:
            self._own["points"] = (
                f"clouds in {lidar} and in {name} on one topic: use more_points_topics"
            )
            return False
        self._lidar = lidar, stamp
        return True

    def _take(self, given: MountedScan) -> list[Reply]:
        core, self.points = self._following(given.T_base_sensor), len(given.scan)
        replies: list[Reply] = []
        if self.settings.odometry == "none":
            self._moved(self.body.standing(given.stamp))
            given.scan.times = None
        elif self.settings.odometry == "kiss-icp":
            replies += self._registered(given)
        if core is not None:
            replies += self._tell(core.add_scan(given.scan, given.stamp))
        return replies

    def on_fix(self, fix: Any) -> None:
        """sensor_msgs/NavSatFix."""
        self._fix = fix

    def on_click(self, click: Click) -> str:
        """A rough pose: it is looked for there, whatever was believed before.

        Returns
        -------
        str
            Why it is passed over; "" where it is not.
        """
        if self._echoes.holds(click.T_map_base):
            return "an echo"
        if frame_name(click.frame) != self.settings.map_frame:
            return f"a click in {click.frame or 'no frame'}, not in {self.settings.map_frame}"
        self.relocalize(click.prior(self.settings.click_radius_m))
        return ""

    def relocalize(self, near: Prior | None = None, anywhere: bool = True) -> int:
        """Forget where it is, and look for it: at the next cloud, without the robot's moving.

        Returns
        -------
        int
            ``fixes`` will be more once it is found.
        """
        if self.keeper is not None:
            self.keeper.drop("overridden by a call")
        self.trigger.wake(near, anywhere)
        self._told, self._own = None, {k: v for k, v in self._own.items() if k != "jump"}
        if self._core is not None:
            self.state = self._core.forget()
        return self.fixes

    def quiet(self, seconds: float) -> list[Reply]:
        """Nothing has come in for so long."""
        if self._core is None or not self._core.scans:
            return []
        return self._tell([self._core.report_silence(seconds)])

    # --- queries -------------------------------------------------------------------------------

    def due(self) -> Job | None:
        """The query to be made now, if any."""
        core = self._core
        asked = None if core is None else core.due()
        if core is None or asked is None:
            return None
        near = self.trigger.near(asked.stamp) or asked.near or self._fixed(asked.stamp)
        if self.trigger.resting:
            core.answer(asked, None)
            return None
        return Job(core, asked, near)

    def _fixed(self, stamp: float) -> Prior | None:
        """Around the newest fix, in every other query while the robot is not localized."""
        is_wanted = self._fix is not None and self.state is not None and not self.state.localized
        if self._localizer is None or not is_wanted:
            return None
        self._own.pop("fix", None)
        try:
            georeference = Georeference.of(self._localizer.prior_map.metadata)
            if georeference is None:
                self._own["fix"] = "GNSS unused: build the map with --epsg and --origin"
                return None
            fixes = Fixes.of(self.settings.fix_topic, [(self._fix, stamp)])
            if not len(fixes):  # the receiver has none
                return None
            times = np.array([stamp])
            (prior,) = gnss_priors(fixes, georeference, times, self.settings.click_radius_m)
            self._is_near_fix = not self._is_near_fix
            if prior is not None:  # the whole map has a query, and a deadline, of its own
                prior = replace(prior, anywhere=False) if self._is_near_fix else None
        except SeglocError as error:
            self._own["fix"] = f"GNSS unused: {error}"
            return None
        return prior

    @staticmethod
    def ask(job: Job) -> Answer:
        """Make a query; any thread may."""
        return make(job)

    def answer(self, answer: Answer) -> list[Reply]:
        """Take a query's answer in; one in a map that was replaced meanwhile is passed over."""
        if answer.job.core is not self._core:
            return []
        if answer.search is not None:
            self.last = answer
        replies = self._tell([answer.job.core.answer(answer.job.asked, answer.view)])
        if answer.candidates:
            frame, stamp = self.settings.map_frame, answer.job.asked.stamp
            replies.append(CandidatesReply(stamp, frame, answer.candidates))
        shown = answer.matches(self.settings.map_frame) if self.settings.matches else None
        return replies if shown is None else [*replies, shown]

    # --- what is known -------------------------------------------------------------------------

    @property
    def believed(self) -> State | None:
        """The state that the pose comes from: what holds at rest, else the newest."""
        return self.trigger.held if self.trigger.resting else self.state

    @property
    def T_map_odom(self) -> Pose | None:
        """(4, 4) float64; None while it is not localized."""
        believed = self.believed
        if believed is None or believed.T_map_odom is None:
            return None
        return believed.T_map_odom @ self.body.T_level_odom

    def initial_pose(self) -> InitialPose | None:
        """Where it is now, for a tracker; None while it is not localized."""
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

    def _following(self, T_base_lidar: Pose) -> LiveCore | None:
        """The core for a mount, begun anew where that has changed."""
        if self._localizer is None:
            return None
        if self._core is None or not same(self._core.T_base_sensor, T_base_lidar):
            self._core = LiveCore(
                self._localizer, self.settings.live, T_base_lidar, keeper=self.keeper
            )
            self.state, self._told, self._jumps = None, None, 0
            for stamp, T in self._odometry:
                self._core.add_odometry(stamp, T)
            self._jumps = self._core.jumps
        return self._core

    def _moved(self, odometry: list[Stamped]) -> list[Reply]:
        replies: list[Reply] = []
        for stamp, T in odometry:
            self._odometry.append((stamp, T))
            if self._core is not None:
                replies += self._tell(self._core.add_odometry(stamp, T))
            replies += self._broadcast(stamp, T)
        return replies

    def _registered(self, given: MountedScan) -> list[Reply]:
        """Compute the odometry of a cloud, and publish it."""
        odometry = self._lidar_odometry
        if odometry is None or not same(odometry.T_base_sensor, given.T_base_sensor):
            odometry = self._lidar_odometry = LidarOdometry(given.T_base_sensor)
        lost, replies = odometry.losses, list[Reply]()
        for time_s, T in odometry.add(given.scan, given.stamp):
            before = self._odometry[-1] if self._odometry else None
            if before is not None and time_s <= before[0]:
                continue
            frames = self.body.odom_frame, self.settings.base_frame
            replies.append(OdometryReply.of(Transform(time_s, *frames, T), before))
            replies += self._moved(self.body.computed(time_s, T))
        if odometry.losses > lost and self._core is not None:
            replies += self._tell([self._core.report_lost_motion(odometry.fault)])
        return replies

    def _broadcast(self, stamp: float, T_odom_base: Pose) -> list[Reply]:
        settings, believed = self.settings, self.believed
        T = None if believed is None else believed.T_map_odom
        if T is None and self._smooth is not None:
            self._smooth.clear()
        if T is None or not settings.tells_tf:
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
                replies += self._told_of(state)
            elif self.keeper is not None and (pose := self._now()) is not None:
                self.keeper.keep(state.stamp, *pose)
        return replies

    def _now(self) -> tuple[Pose, Pose, Float64 | None] | None:
        """T_map_base, T_odom_base, and the covariance when it was measured."""
        believed, state = self.believed, self.state
        if state is None or believed is None or believed.T_map_odom is None:
            return None
        if state.T_odom_base is None:
            return None
        return believed.T_map_odom @ state.T_odom_base, state.T_odom_base, believed.covariance

    def _notice_jumps(self) -> None:
        core = self._core
        if core is None or core.jumps == self._jumps:
            return
        self._jumps = core.jumps
        if self.trigger.resting and self.trigger.held is not None:
            self.trigger.lose()
            self._told, self.state = None, core.forget()
            if self.trigger.resting:
                self._own["jump"] = "the odometry jumped: call ~/relocalize"

    def _told_of(self, state: State) -> list[Reply]:
        replies: list[Reply] = []
        if (pose := self._published(state)) is not None:
            replies.append(PoseReply.of(state.stamp, self.settings.map_frame, *pose))
        if not state.localized:
            self._told = None
        elif state.status is Status.LOCALIZED and self._is_news(state):
            self.fixes += 1
            told = self.initial_pose()
            if self.settings.tells_initialpose and told is not None:
                replies.append(told)
            self.trigger.found(state)
        return replies

    def _published(self, state: State) -> tuple[Pose, Float64 | None] | None:
        """T_map_base and covariance, consistent with map -> odom where that is smooth."""
        T, T_odom_base = state.T_map_base, state.T_odom_base
        smooth = None if self._smooth is None else self._smooth.T_map_odom
        if T is None or T_odom_base is None or state.T_map_odom is None:
            return None
        if self._smooth is None or smooth is None or state.covariance is None:
            return T, state.covariance
        offset = self._smooth.offset(state.T_map_odom, T_odom_base)
        return smooth @ T_odom_base, state.covariance + np.outer(offset, offset)

    def _is_news(self, state: State) -> bool:
        """Whether a tracker that was told before would now be wrong."""
        if self._told is None or state.T_odom_base is None or state.T_map_base is None:
            return True
        return _MOVED.apart(self._told @ state.T_odom_base, state.T_map_base)
