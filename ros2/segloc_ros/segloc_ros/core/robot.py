"""The node without ROS: what topics say goes in, what is to be published comes out.

No threads and no clock but for durations. Queries are handed out, made elsewhere, and answered, as
with :class:`segloc.live.LiveCore`, around which this is.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np

from segloc import Localizer, Prior, SeglocError, geometry
from segloc.datasets.ros.pointcloud2 import to_scan
from segloc.live import LiveCore, State, Status
from segloc.types import Float64, Pose

from .body import Body, Stamped, same
from .clicks import Click, Echoes
from .frames import Transform, frame_name
from .queries import Answer, Job, make
from .replies import InitialPose, MapToOdom, PoseReply, Reply
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
    intake_ms : float
        What the last cloud took.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.body = Body(settings)
        self.trigger = Trigger(settings.trigger, settings.click_s)
        self.state: State | None = None
        self.last: Answer | None = None
        self.fixes, self.intake_ms = 0, 0.0
        self._localizer: Localizer | None = None
        self._core: LiveCore | None = None
        self._own = {
            "map": "the map is being read",
            "points": f"no cloud yet: {settings.points_topic}",
        }
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

    def on_cloud(self, cloud: Any, stamp: float, frame: str) -> list[Reply]:
        """sensor_msgs/PointCloud2. What cannot be used is refused, and that is said."""
        begun = time.perf_counter()
        self._own.pop("points", None)
        lidar = frame_name(frame)
        if lidar != self._lidar[0] and 0.0 <= stamp - self._lidar[1] < self.settings.silent_s:
            self._own["points"] = f"clouds in {lidar} and in {self._lidar[0]}: give those of one"
            return []
        self._lidar = lidar, stamp
        T_base_lidar = self.body.mount(lidar)
        if T_base_lidar is None or (core := self._following(T_base_lidar)) is None:
            return []
        try:
            scan = to_scan(cloud, stamp)
            if self.settings.odometry == "none":
                self._moved(self.body.standing(stamp))
                scan.times = None
            replies = self._tell(core.add_scan(scan, stamp))
        except SeglocError as error:
            core.refused += 1
            self._own["points"] = f"cloud refused: {error}"
            return []
        self.intake_ms = 1e3 * (time.perf_counter() - begun)
        return replies

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
        near = self.trigger.near(asked.stamp)
        if self.trigger.resting:
            core.answer(asked, None)
            return None
        return Job(core, asked, near)

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
        believed, state = self.believed, self.state
        if state is None or believed is None or believed.T_map_odom is None:
            return None
        if state.T_odom_base is None:
            return None
        T = believed.T_map_odom @ state.T_odom_base
        self._told = believed.T_map_odom
        self._echoes.sent(T)
        least = (self.settings.initialpose_least_m, self.settings.initialpose_least_deg)
        frame = self.settings.map_frame
        return InitialPose(PoseReply.of(state.stamp, frame, T, believed.covariance, least))

    # --- inside --------------------------------------------------------------------------------

    def _following(self, T_base_lidar: Pose) -> LiveCore | None:
        """The core for a mount, begun anew where that has changed."""
        if self._localizer is None:
            return None
        if self._core is None or not same(self._core.T_base_sensor, T_base_lidar):
            self._core = LiveCore(self._localizer, self.settings.live, T_base_lidar)
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
            replies += self._broadcast(stamp)
        return replies

    def _broadcast(self, stamp: float) -> list[Reply]:
        T, settings = self.T_map_odom, self.settings
        if T is None or not settings.tells_tf:
            return []
        if 0.0 <= stamp - self._sent_at < 1.0 / settings.tf_rate_hz:
            return []
        self._sent_at = stamp
        ahead = stamp + settings.tf_ahead_s
        return [MapToOdom(Transform(ahead, settings.map_frame, self.body.odom_frame, T))]

    def _tell(self, states: list[State]) -> list[Reply]:
        replies: list[Reply] = []
        for state in states:
            self.state = state
            self._notice_jumps()
            if not self.trigger.resting:
                replies += self._told_of(state)
        return replies

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
        T = state.T_map_base
        if T is not None:
            frame = self.settings.map_frame
            replies.append(PoseReply.of(state.stamp, frame, T, state.covariance))
        if not state.localized:
            self._told = None
        elif state.status is Status.LOCALIZED and self._is_news(state):
            self.fixes += 1
            pose = self.initial_pose()
            if self.settings.tells_initialpose and pose is not None:
                replies.append(pose)
            self.trigger.found(state)
        return replies

    def _is_news(self, state: State) -> bool:
        """Whether a tracker that was told before would now be wrong."""
        if self._told is None or state.T_odom_base is None or state.T_map_base is None:
            return True
        return _MOVED.apart(self._told @ state.T_odom_base, state.T_map_base)
