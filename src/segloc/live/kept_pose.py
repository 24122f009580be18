"""A pose kept over a power cycle, and verified before it is used again."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import geometry
from ..errors import SeglocError
from ..map.identity import map_id
from ..map.segment_map import SegmentMap
from ..prior import Prior
from ..system.checks import checked_pose
from ..system.files import write_text
from ..types import Float64, Pose

_VERSION = 1
_SIGMAS = 3.0
_MAX_SPEED_MPS = 60.0


@dataclass(frozen=True)
class KeptPose:
    """Contents of a pose file; ``sigma_m`` is of the horizontal position, along its worst axis."""

    map_id: str
    stamp: float
    T_map_base: Pose
    T_odom_base: Pose
    sigma_m: float

    @classmethod
    def load(cls, path: Path) -> KeptPose | None:
        """Read a pose file, if there is one; raise SeglocError, which names its fault."""
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            if values["version"] != _VERSION:
                raise ValueError(f"version {values['version']}, not {_VERSION}")
            poses = [checked_pose(values[name], name) for name in ("T_map_base", "T_odom_base")]
            stamp, sigma = float(values["stamp"]), float(values["sigma_m"])
            if not (math.isfinite(stamp) and math.isfinite(sigma)):
                raise ValueError("a number that is not finite")
            return cls(str(values["map_id"]), stamp, poses[0], poses[1], sigma)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise SeglocError(f"{path}: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise SeglocError(f"{path}: not a pose file: {error!r:.80}") from error

    def save(self, path: Path) -> None:
        """Replace a pose file, whole or not at all; raise SeglocError if it cannot be written."""
        values = {"version": _VERSION, **vars(self)}
        write_text(path, json.dumps(values, indent=1, default=np.ndarray.tolist) + "\n")

    def predicted(self, stamp: float, T_odom_base: Pose) -> Pose:
        """T_map_base at a later pose of the odometry.

        Odometry that restarted is nearer to its origin than to the kept pose: then the base is
        expected where it was kept.
        """
        moved_m = float(np.linalg.norm(T_odom_base[:3, 3] - self.T_odom_base[:3, 3]))
        is_reachable = moved_m <= _MAX_SPEED_MPS * max(0.0, stamp - self.stamp)
        if is_reachable and moved_m < float(np.linalg.norm(T_odom_base[:3, 3])):
            return self.T_map_base @ geometry.inverse(self.T_odom_base) @ T_odom_base
        return self.T_map_base


class PoseKeeper:
    """Keeps a robot's pose in a file; after a restart the first queries search near it.

    Parameters
    ----------
    path : path
    every_s : float
        Time between writes [s].
    max_age_s : float
        An older pose is not used [s].
    radius_m : float
        Smallest radius of the search near the kept pose [m].
    check_s : float
        The whole map is searched if the pose is not confirmed within this time [s].

    Attributes
    ----------
    notes : list of str
        What became of the kept pose, for the log; whoever reads them clears them.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        every_s: float = 5.0,
        max_age_s: float = math.inf,
        radius_m: float = 10.0,
        check_s: float = 5.0,
    ) -> None:
        self.path = Path(path)
        self.notes: list[str] = []
        self._every_s, self._max_age_s = every_s, max_age_s
        self._radius_m, self._check_s = radius_m, check_s
        self._map_id, self._is_recalled = "", False
        self._expected: KeptPose | None = None
        self._until, self._written_at = math.inf, -math.inf
        self._newest: KeptPose | None = None
        self._fault = ""

    def use(self, prior_map: SegmentMap) -> None:
        """Take the map that poses are in from now on."""
        self.flush()
        before, self._map_id, self._newest = self._map_id, map_id(prior_map), None
        if self._map_id != before:
            self.drop("of another map")

    def near(self, stamp: float, T_odom_base: Pose, T_base_sensor: Pose) -> Prior | None:
        """Return where the sensor is searched while the kept pose is checked, else None."""
        if not self._is_recalled:
            self._is_recalled, self._until = True, stamp + self._check_s
            self._expected = self._recall(stamp)
        expected = self._expected
        if expected is None:
            return None
        if not self._until - self._check_s <= stamp <= self._until:
            self.drop(f"not confirmed within {self._check_s:g} s: the robot was moved, or the map")
            return None
        T = expected.predicted(stamp, T_odom_base) @ T_base_sensor
        return Prior(T[:3, 3], max(self._radius_m, _SIGMAS * expected.sigma_m))

    def drop(self, why: str) -> None:
        """Stop checking the kept pose."""
        if self._expected is not None:
            self._expected = None
            self._note_unused(why)

    def keep(
        self, stamp: float, T_map_base: Pose, T_odom_base: Pose, covariance: Float64 | None
    ) -> None:
        """Keep an accepted pose; at intervals it is written."""
        if (expected := self._expected) is not None:
            T = expected.predicted(stamp, T_odom_base)
            off_m = float(np.linalg.norm(T[:3, 3] - T_map_base[:3, 3]))
            self._expected = None
            self.notes.append(f"kept pose confirmed, {off_m:.2f} m off")
        self._is_recalled = True
        sigma = 1.0 if covariance is None else float(np.sqrt(np.diag(covariance)[3:5].max()))
        self._newest = KeptPose(self._map_id, stamp, T_map_base, T_odom_base, sigma)
        if not 0.0 <= stamp - self._written_at < self._every_s:
            self.flush()

    def flush(self) -> None:
        """Write the newest pose now. A fault is noted, never raised."""
        if self._newest is None or self._newest.stamp == self._written_at:
            return
        self._written_at = self._newest.stamp
        try:
            self._newest.save(self.path)
            self._fault = ""
        except SeglocError as error:
            if str(error) != self._fault:
                self.notes.append(f"pose not kept: {error}")
            self._fault = str(error)

    def _recall(self, stamp: float) -> KeptPose | None:
        try:
            kept = KeptPose.load(self.path)
        except SeglocError as error:
            self._note_unused(str(error))
            return None
        if kept is None:
            self._note_unused(f"no file {self.path} yet")
        elif kept.map_id != self._map_id:
            self._note_unused("of another map, or of an earlier state of this one")
        elif stamp - kept.stamp > self._max_age_s:
            self._note_unused(f"{stamp - kept.stamp:.0f} s old, limit {self._max_age_s:g} s")
        else:
            return kept
        return None

    def _note_unused(self, why: str) -> None:
        self.notes.append(f"kept pose: {why}; searching the whole map")
