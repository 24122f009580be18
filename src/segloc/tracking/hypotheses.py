"""What successive views say of where a robot is: one believed track, and candidates for another.

Pure bookkeeping: no clouds, no clocks. Poses are ``T_map_odom``; how old they are is measured by
the distance travelled.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .. import geometry
from ..types import Float64, Pose
from .views import Check, HypothesesConfig, Hypothesis, Status, View

OFF_THE_MAP = "little of what is seen is in the map"
UNCONFIRMED = "the newest scan does not confirm the track"
_SURE_M = 10.0
"""Where queries found places alike, one is believed once they have agreed on it for so much travel;
and a doubted track once all scans have fitted for as much, or as much as none did: a few fit by
chance. Set by hand."""


class Hypotheses:
    """Keeps a track while views support it, and gives it up when they speak against it.

    A view that passes all gates of verification is believed at once, and only after some travel
    where views before it found places alike. A pose that is only likely is kept as a candidate
    until views that share no scan agree on it. Once there is a track, what counts is what was seen
    last: a single view that contradicts it makes it doubtful, the next one ends it, however many
    views supported it before.

    Attributes
    ----------
    track : Hypothesis or None
    doubt : str
        Why the track is doubted; "" where it is not.
    """

    def __init__(self, config: HypothesesConfig | None = None) -> None:
        self.config = config or HypothesesConfig()
        self.track: Hypothesis | None = None
        self.doubt = ""
        self._doubts = 0
        self._unconfirmed_at: float | None = None  # travelled distance since which the track is not
        self._fits_from: float | None = None  # confirmed, and since which all scans fit it again
        self._ends_at = math.inf  # travelled distance at which an unconfirmed track ends
        self._candidates: list[Hypothesis] = []
        self._alike = False  # whether a query fitted several places since there is no track
        self._by_scan = False  # whether a single scan has said last where the track is

    @property
    def candidates(self) -> tuple[Hypothesis, ...]:
        """What is likely but not believed, the likeliest first."""
        return tuple(self._candidates)

    @property
    def contradicted(self) -> bool:
        """Whether something speaks against the track."""
        return self.track is not None and self._doubts > 0

    def clear(self) -> None:
        """Forget everything."""
        self._end("")
        self._candidates = []

    def carry(self, T_new_old: Pose, travelled: float, doubt: str) -> None:
        """Follow a jump of the odometry: the robot is taken to stand where it stood before.

        Parameters
        ----------
        T_new_old : (4, 4) float64
            From the odometry's frame before the jump to that after it.
        travelled : float
            Metres. Without support the track ends ``confirm_m`` later.
        doubt : str
            Why the track is doubted until then.
        """
        self._candidates = []
        if self.track is not None:
            T = self.track.T_map_odom @ geometry.inverse(T_new_old)
            where = T_new_old @ self.track.T_odom_sensor
            self.track = replace(self.track, T_map_odom=T, T_odom_sensor=where)
            self.doubt, self._doubts = doubt, max(self._doubts, self.config.doubts - 1)
            self._ends_at = travelled + self.config.confirm_m

    def take(self, view: View) -> None:
        """Let a view support the track, or speak against it."""
        self.forget(view.at)
        if self.track is None:
            self._look(view)
        elif view.check is Check.CONTRADICTS:
            self._doubt(view, "the map contradicts the track")
        elif view.check is Check.UNMAPPED and self._agrees(view):  # by what was seen before
            self._unconfirm(view, OFF_THE_MAP)
        elif view.T_map_odom is not None and self._agrees(view):
            self._support(view, view.T_map_odom)
        elif view.check is Check.HOLDS and view.T_checked is not None:
            self._hold(view)
        elif view.believed and view.T_map_odom is not None:
            self._add(view, view.T_map_odom)
            self._doubt(view, "another place fits better")
        elif view.check is Check.UNMAPPED:
            self._unconfirm(view, OFF_THE_MAP)
        elif view.T_checked is not None:
            self._unconfirm(view, UNCONFIRMED)

    def forget(self, travelled: float) -> None:
        """Drop what nothing has supported for long."""
        config, track = self.config, self.track
        if track is not None and travelled - track.since > config.memory_m:
            self._end(f"nothing supported the track for {config.memory_m:g} m")
        if self.track is not None and travelled > self._ends_at:
            self._end(self.doubt)
        fresh = [k for k in self._candidates if travelled - k.since <= config.memory_m]
        fresh.sort(key=lambda k: (-k.views, -k.believed, -k.confidence))
        self._candidates = fresh[: config.max_kept]

    def status(self, travelled: float) -> tuple[Status, str]:
        """How well it is known where the robot is, and why not better."""
        if self.track is None:
            if self._candidates:
                return Status.CANDIDATE, self._undecided()
            return Status.LOST, self.doubt or "nothing found"
        if self.doubt:
            return Status.DEGRADED, self.doubt
        unsupported = travelled - self.track.since
        if unsupported > self.config.support_m:
            return Status.DEGRADED, f"nothing supports the track since {unsupported:.0f} m"
        return Status.LOCALIZED, ""

    def covariance(self, travelled: float, T_odom_sensor: Pose) -> Float64 | None:
        """Of the sensor's pose in the map, grown by what odometry errs since the last support."""
        track = self.track
        if track is None or track.covariance is None:
            return None
        T_now_then = geometry.inverse(T_odom_sensor) @ track.T_odom_sensor
        carried = geometry.carried_covariance(track.covariance, T_now_then)
        path = max(0.0, travelled - track.since)
        turn, shift = math.radians(self.config.drift_deg) * path, self.config.drift * path
        return carried + np.diag(np.repeat([turn**2, shift**2], 3))

    # --- inside --------------------------------------------------------------------------------

    def _look(self, view: View) -> None:
        """Without a track: a candidate more, and perhaps one to be believed."""
        if view.ambiguous:
            self._candidates, self._alike = [], True
        if view.T_map_odom is None:
            return
        self._add(view, view.T_map_odom)
        standing = self._standing()
        standing.sort(key=lambda k: (-k.views, -k.confidence))
        if standing and (len(standing) == 1 or standing[0].views > standing[1].views):
            self._begin(standing[0])

    def _standing(self) -> list[Hypothesis]:
        """Candidates that may become the track."""
        least_m, agreeing = _SURE_M if self._alike else 0.0, self.config.agreeing
        long = (k for k in self._candidates if k.since - k.begun >= least_m)
        return [k for k in long if k.believed or k.views >= agreeing]

    def _begin(self, found: Hypothesis) -> None:
        self._follow(found)
        self._unconfirmed_at, self._alike, self._by_scan = None, False, False

    def _follow(self, track: Hypothesis) -> None:
        self.track, self.doubt, self._doubts, self._ends_at = track, "", 0, math.inf
        self._candidates = []

    def _end(self, doubt: str) -> None:
        self.track, self.doubt, self._doubts, self._ends_at = None, doubt, 0, math.inf
        self._unconfirmed_at, self._alike = None, False

    def _support(self, view: View, T_map_odom: Pose) -> None:
        """Another query agrees; where its newest scan fits, that tells best where the robot is."""
        assert self.track is not None
        independent = view.at - self.track.at >= self.config.apart_m
        joined = self.track.joined(view, T_map_odom, independent)
        self._go_on(joined.placed(view) if view.check is Check.HOLDS else joined, view)

    def _go_on(self, track: Hypothesis, view: View) -> None:
        """Follow a track that a view supports; doubted on, unless its newest scan confirms it.

        What was seen before agrees, too, where a robot was carried to a place that looks alike.
        """
        steady = self._is_steady(view)
        self._follow(track)
        self._by_scan = view.check is Check.HOLDS
        if view.T_checked is not None and (view.check is Check.UNDECIDED or not steady):
            self._unconfirm(view, UNCONFIRMED)
            if view.check is Check.HOLDS:
                self._unconfirmed_at = -math.inf  # it may never have fitted where it was
        elif self._unconfirmed_at is not None and not self._regained(view, self._unconfirmed_at):
            self.doubt = UNCONFIRMED
        else:
            self._unconfirmed_at = None

    def _unconfirm(self, view: View, doubt: str) -> None:
        """Note since when scans do not confirm the track."""
        if self._unconfirmed_at is None:
            self._unconfirmed_at = view.at
        self._fits_from = None
        self.doubt = self.doubt or doubt

    def _is_steady(self, view: View) -> bool:
        """Whether the newest scan fits where odometry leads, and not only somewhere nearby.

        Rooms that look alike have their walls a little elsewhere. After a jump odometry leads
        nowhere, and clouds of many scans fit where their drift puts them.
        """
        if self.track is None or view.T_checked is None:
            return True
        if self._ends_at < math.inf or not self._by_scan:
            return True
        moved_m, _ = self.track.apart(view, view.T_checked)
        return moved_m <= self.config.steady_m + self._drifted(self.track, view)

    def _regained(self, view: View, unconfirmed_at: float) -> bool:
        """Whether scans have fitted an unconfirmed track for as long as they had not."""
        if self._fits_from is None:
            self._fits_from = view.at
        without = self._fits_from - unconfirmed_at
        return view.at - self._fits_from >= min(without, _SURE_M)

    def _hold(self, view: View) -> None:
        """The newest scan fits where the track is; another place that fits, too, is no rival yet.

        Before as many views have spoken for the track as for that place it is chance which of the
        two came first.
        """
        assert self.track is not None
        if view.believed and view.T_map_odom is not None:
            rival = self._add(view, view.T_map_odom)
            if rival.views >= self.track.views:
                self._doubt(view, "another place fits as well")
                return
        candidates = self._candidates
        self._go_on(self.track.placed(view), view)
        self._candidates = candidates

    def _doubt(self, view: View, why: str) -> None:
        """Speak against the track; the last doubt ends it, and another place may take over."""
        self._doubts += 1
        self._unconfirm(view, why)
        self.doubt = why
        if self._doubts < self.config.doubts:
            return
        self._end(why)
        standing = [k for k in self._candidates if k.believed and k.since >= view.at]
        if len(standing) == 1 and view.check is not Check.HOLDS:
            self._begin(standing[0])

    def _add(self, view: View, T_map_odom: Pose) -> Hypothesis:
        """Let a view support the candidate that it agrees with, or be one itself."""
        for i, old in enumerate(self._candidates):
            if self._agree(old, view, T_map_odom):
                # Scans that both have in common fit at the same wrong places.
                apart = view.at - old.at
                independent = apart >= self.config.apart_m and apart > view.reach_m
                self._candidates[i] = old.joined(view, T_map_odom, independent)
                return self._candidates[i]
        self._candidates.append(Hypothesis.of(view, T_map_odom))
        return self._candidates[-1]

    def _agrees(self, view: View) -> bool:
        """Whether a view puts the robot where the track does."""
        track, T = self.track, view.T_map_odom
        return track is not None and T is not None and self._agree(track, view, T)

    def _agree(self, old: Hypothesis, view: View, T_map_odom: Pose) -> bool:
        config = self.config
        moved_m, turned_deg = old.apart(view, T_map_odom)
        slack = config.tolerance_m + self._drifted(old, view)
        return moved_m <= slack and turned_deg <= config.tolerance_deg

    def _drifted(self, old: Hypothesis, view: View) -> float:
        """Metres that odometry may have erred since a hypothesis was last supported."""
        return self.config.drift * max(0.0, view.at - old.since)

    def _undecided(self) -> str:
        standing = self._standing()
        return self.doubt or ("contradiction" if standing else "no agreement yet")
