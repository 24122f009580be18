"""Measure how far a session's poses are off a map: its scans are localized there.

A session some metres off still agrees with the map well enough to be added, and doubles every
object. Localization needs no initial guess, so a shift of any size is found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import geometry
from ..config import Config, map_config
from ..errors import MapMismatch, WeightsError
from ..frontend.local_cloud import Accumulator, window
from ..localizer import Localizer
from ..map.config import BuildConfig
from ..map.segment_map import SegmentMap
from ..prior import Prior
from ..system.text import quantity
from ..types import Float64, LocalCloud, Pose, Recording
from .same_place import MEET_HEIGHT_M, MEET_M

MAX_SHIFT_M, MAX_TURN_DEG = 0.5, 1.0
"""Largest median shift and turn of a session that is added to a map."""
TO_THE_FRAME = "`segloc align` (segloc.align_to_map) brings poses into the map's frame"

_MAX_CLOUDS, _MAX_SCANS = 20, 8  # clouds of a session, and scans of a cloud
_MIN_LOCALIZED = 3  # fewer answers do not reject a session
_REACH_M, _NEAR_M = 30.0, 60.0
"""Distance from the map's trajectory of clouds that are chosen first, and from their poses of
places that are searched first [m]."""

Progress = Callable[[int, int], None]
Opened = Callable[[Config], Localizer]
Session = Recording | SegmentMap
Posed = tuple[Pose, LocalCloud]
"""T_map_sensor of a local cloud's sensor by the session's poses, and the cloud."""


@dataclass(frozen=True)
class Shift:
    """Displacement of a session's poses against a map.

    Attributes
    ----------
    clouds, localized : int
        Numbers of local clouds of the session that were searched, and that were localized.
    shift_m, turn_deg : float
        Median distance and angle between the poses of those localized and the answers; 0 if none.
    why : str
        Reason if no cloud was searched.
    storeys : int
        Number of clouds that were localized above or below, on a storey that looks alike.
    """

    clouds: int
    localized: int
    shift_m: float
    turn_deg: float
    why: str = ""
    storeys: int = 0

    @classmethod
    def of(cls, clouds: int, displacements: list[tuple[float, float]], storeys: int = 0) -> Shift:
        """Return the medians of (shift [m], turn [deg])."""
        shift_m, turn_deg = np.median(displacements, axis=0) if displacements else np.zeros(2)
        return cls(clouds, len(displacements), float(shift_m), float(turn_deg), storeys=storeys)

    @classmethod
    def unknown(cls, why: str) -> Shift:
        """Return the shift of a session that cannot be searched in the map."""
        return cls(0, 0, 0.0, 0.0, why)

    @property
    def is_known(self) -> bool:
        """True if enough clouds were localized."""
        return self.localized >= min(_MIN_LOCALIZED, max(self.clouds, 1))

    @property
    def remark(self) -> str:
        """Return why the shift is not known, "" if it is."""
        if self.is_known:
            return ""
        if 2 * self.storeys > self.clouds:
            return (
                f"{self.storeys} of {quantity(self.clouds, 'places')} along it look like those "
                "above or below in the map: another storey, unless its heights are wrong"
            )
        return self.why or (
            f"{self.localized} of {quantity(self.clouds, 'places')} along it are localized in the "
            "map: it is elsewhere, or the place looks too different"
        )

    @property
    def is_too_large(self) -> bool:
        """True if the session would double the map's objects."""
        return self.is_known and (self.shift_m > MAX_SHIFT_M or self.turn_deg > MAX_TURN_DEG)

    def __str__(self) -> str:
        return f"{self.shift_m:.2f} m and {self.turn_deg:.1f} degrees"


def check_shift(
    prior_map: SegmentMap,
    session: Session,
    config: BuildConfig | None = None,
    *,
    name: str = "the session",
    remedy: str = TO_THE_FRAME,
    progress: Progress | None = None,
    localizer: Opened | None = None,
) -> Shift:
    """Measure the shift of a session, and reject one that is too large.

    Parameters
    ----------
    prior_map, session, config, progress, localizer
        As for :func:`measure_shift`.
    name, remedy : str
        For the message.

    Raises
    ------
    MapMismatch
        If the median shift exceeds ``MAX_SHIFT_M`` or the turn ``MAX_TURN_DEG``.
    """
    found = measure_shift(prior_map, session, config, progress, localizer)
    if found.is_too_large:
        raise MapMismatch(
            f"{name}: its poses are {found} off the map (median of {found.localized} of "
            f"{found.clouds} places along it; at most {MAX_SHIFT_M:g} m and {MAX_TURN_DEG:g} "
            f"degree): {remedy}"
        )
    return found


def measure_shift(
    prior_map: SegmentMap,
    session: Session,
    config: BuildConfig | None = None,
    progress: Progress | None = None,
    localizer: Opened | None = None,
) -> Shift:
    """Measure the shift of a session against a map, by localizing some of its clouds there.

    Parameters
    ----------
    prior_map : SegmentMap
        Of tiles, the thin map of all of them.
    session : Recording or SegmentMap
        With poses in the frame of the map; of a map, its cloud around its trajectory is localized.
    config : BuildConfig, optional
        By default the map's.
    progress : callable, optional
        Called with (clouds done, total).
    localizer : callable, optional
        Returns the localizer for a configuration, of tiles; by default that in the map.

    Raises
    ------
    DatasetError
        If a scan cannot be read.
    """
    path = session.trajectory if isinstance(session, SegmentMap) else session.poses
    searchable = len(prior_map) and (localizer or len(prior_map.cloud))
    if path is None or not len(path) or not searchable:
        return Shift.unknown("one of them has no trajectory or no cloud")
    try:
        settings = _settings(prior_map, config)
        opened = localizer(settings) if localizer else Localizer(prior_map, settings)
    except (MapMismatch, WeightsError) as error:
        return Shift.unknown(str(error))
    chosen, near_m = _stations(path, prior_map.trajectory)
    displacements, storeys = [], 0
    for done, (T_map_sensor, cloud) in enumerate(_clouds(session, chosen, opened.config), 1):
        near = Prior(T_map_sensor[:2, 3], near_m, anywhere=True) if near_m else None
        answer = opened.locate(opened.describe(cloud), near=near)
        if answer.localized and _is_storey_apart(T_map_sensor, answer.T_map_sensor):
            storeys += 1
        elif answer.localized:
            displacements.append(_displacement(T_map_sensor, answer.T_map_sensor))
        if progress:
            progress(done, len(chosen))
    return Shift.of(len(chosen), displacements, storeys)


def _is_storey_apart(T_map_sensor: Pose, T_answer: Pose) -> bool:
    """Return whether an answer is right above or below the pose, as where storeys are alike."""
    x, y, z = T_answer[:3, 3] - T_map_sensor[:3, 3]
    return bool(abs(z) > MEET_HEIGHT_M and np.hypot(x, y) < MEET_M)


def _settings(prior_map: SegmentMap, config: BuildConfig | None) -> Config:
    """Return the settings of queries; of those of a build, the ones that they share."""
    own = map_config(prior_map)
    if config is None or isinstance(config, Config):
        return config or own
    shared = ("method", "weights", "threads", "local_cloud")
    return own.model_copy(update={key: getattr(config, key) for key in shared})


def _stations(path: Float64, mapped: Float64) -> tuple[list[int], float]:
    """Choose poses spread over a session, of those near the map's trajectory if there are any.

    Also return the radius within which they are searched first [m], 0 if none is near.
    """
    near, radius_m = np.arange(len(path)), 0.0
    if len(mapped):
        positions = path[:, :3, 3]
        distances, _ = cKDTree(mapped[:, :3, 3]).query(positions, distance_upper_bound=_REACH_M)
        reached = np.flatnonzero(np.isfinite(distances))
        near, radius_m = (reached, _NEAR_M) if len(reached) else (near, 0.0)
    travelled = geometry.distance_travelled(path[near])
    even = np.linspace(0.0, travelled[-1], min(_MAX_CLOUDS, len(near)))
    return [int(k) for k in near[np.unique(np.searchsorted(travelled, even))]], radius_m


def _clouds(session: Session, chosen: list[int], config: Config) -> Iterator[Posed]:
    """Yield the local clouds of a session at some of its poses."""
    if isinstance(session, SegmentMap):
        return _around(session, chosen, config.local_cloud.radius_m)
    return _accumulate(session, chosen, config)


def _accumulate(recording: Recording, chosen: list[int], config: Config) -> Iterator[Posed]:
    """Yield clouds of some scans around each pose: all of a window could be hundreds."""
    local, poses = config.local_cloud, recording.poses
    assert poses is not None
    accumulator = Accumulator(local)
    for k in chosen:
        around = window(poses, k, local.window_m, centred=True, max_gap_m=local.max_gap_m)
        spread = [around[i] for i in geometry.spread(len(around), _MAX_SCANS)]
        numbers = sorted({*spread, k})
        cloud = accumulator.gather([recording.scan(i) for i in numbers], numbers.index(k))
        yield poses[k], cloud


def _around(prior_map: SegmentMap, chosen: list[int], radius_m: float) -> Iterator[Posed]:
    """Yield the parts of a map's cloud around some poses of its trajectory."""
    cloud, origin = prior_map.cloud, prior_map.origin
    for k in chosen:
        T_map_local = geometry.levelled(prior_map.trajectory[k])
        offsets = cloud[:, :2] - (T_map_local[:2, 3] - origin[:2])
        near = np.einsum("ij,ij->i", offsets, offsets) < radius_m**2
        points = geometry.transform(geometry.inverse(T_map_local), cloud[near] + origin)
        yield T_map_local, LocalCloud(points.astype(np.float32), np.eye(4), num_scans=2)


def _displacement(T_map_sensor: Pose, T_answer: Pose) -> tuple[float, float]:
    """Return the shift [m] and turn [deg] between two poses."""
    shift_m = float(np.linalg.norm(T_answer[:3, 3] - T_map_sensor[:3, 3]))
    turn = geometry.rotation_angle(geometry.inverse(T_map_sensor) @ T_answer)
    return shift_m, float(np.degrees(turn))
