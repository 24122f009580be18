"""Check that two maps are of one place in one frame, where their trajectories meet.

There the clouds must agree better than with one of them shifted by a few metres, since ground and
similar streets agree anywhere. ``agreement`` is the share of points with a point of the other cloud
nearby, scaled so that chance is 0 and identity 1. Nor may turning one cloud by some degrees improve
the agreement much: small places still agree somewhat when turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import geometry
from ..errors import MapMismatch
from ..map.georeference import Georeference
from ..map.segment_map import SegmentMap
from ..types import Float64

MEET_M, MEET_HEIGHT_M = 5.0, 2.0
"""Maximum distance between trajectories that meet: a street's width, less than a storey."""

MIN_AGREEMENT = 0.5
MAX_GAIN = 0.1
"""As measured in docs/how-to/align.md."""

_AROUND_M = 15.0  # range compared, which both sessions cover well
_NEAR_M = 1.0  # positions of two passes agree to about a metre
_SHIFTS_M = (4.0, 6.0)
_TURNS_DEG = (-15.0, -10.0, -5.0, 5.0, 10.0, 15.0)
_OPPOSITE = tuple(1 + _TURNS_DEG.index(-turn) for turn in _TURNS_DEG)
_MAX_POINTS = 20_000
_MIN_POINTS = 200
_MAX_MEETINGS = 300


@dataclass(frozen=True)
class Meeting:
    """Agreement of two maps where they meet.

    Attributes
    ----------
    places : int
        Number of poses of either trajectory near the other's.
    points : int
        Number of points compared there.
    agreement : float or None
        0 by chance, 1 if every point is in both clouds; None if too few points were compared.
    gain : float
        Maximum increase of the agreement with one of the clouds turned by 5 to 15 degrees.
    """

    places: int
    points: int
    agreement: float | None
    gain: float = 0.0


def check_same_place(
    mine: SegmentMap, theirs: SegmentMap, *, elsewhere: bool = False, unchecked: bool = False
) -> None:
    """Reject two maps that are not of one place in one frame.

    Maps without a trajectory, a cloud or segments pass, as do maps with too few points where they
    meet.

    Parameters
    ----------
    mine, theirs : SegmentMap
    elsewhere : bool
        True to allow maps that do not meet: two places in one frame.
    unchecked : bool
        True to compare nothing but their georeferences.

    Raises
    ------
    MapMismatch
        If they do not meet, or their clouds disagree where they do.
    """
    check_same_frame(mine, theirs)
    if unchecked or not all(len(part.trajectory) and len(part.cloud) for part in (mine, theirs)):
        return
    found = meeting(mine, theirs)
    if not found.places:
        if elsewhere:
            return
        raise MapMismatch(
            f"the trajectories of the maps do not meet (within {MEET_M:g} m): two places or two "
            "frames; --elsewhere joins two places of one frame"
        )
    if found.agreement is not None and found.agreement < MIN_AGREEMENT:
        raise MapMismatch(
            f"the maps are in two frames: where they meet ({found.places} poses), the "
            f"clouds overlap no better than chance ({found.agreement:.2f}, needs {MIN_AGREEMENT:g})"
        )
    if found.agreement is not None and found.gain > MAX_GAIN:
        raise MapMismatch(
            f"the maps are in two frames: where they meet ({found.places} poses), the "
            "clouds agree much better if one is turned by some degrees "
            f"({found.agreement + found.gain:.2f} instead of {found.agreement:.2f})"
        )


def check_same_frame(mine: SegmentMap, theirs: SegmentMap) -> None:
    """Reject maps whose georeferences differ.

    Raises
    ------
    MapMismatch
        If both have a georeference, and these differ.
    """
    named = [Georeference.of(each.metadata) for each in (mine, theirs)]
    if None not in named and named[0] != named[1]:
        raise MapMismatch(f"the maps are in two frames: {named[0]}, and {named[1]}")


def meets(mine: SegmentMap, theirs: SegmentMap) -> bool:
    """Return whether the trajectories of two maps meet."""
    return len(_places(mine, theirs)) > 0


def meeting(mine: SegmentMap, theirs: SegmentMap) -> Meeting:
    """Measure the agreement of two maps where their trajectories meet."""
    origin = mine.origin  # UTM coordinates would lose precision
    places = _places(mine, theirs)
    if not len(places):
        return Meeting(0, 0, None)
    chosen = places[:: len(places) // _MAX_MEETINGS + 1]
    clouds = [_around(part.cloud + (part.origin - origin), chosen) for part in (mine, theirs)]
    fewest = min(map(len, clouds))
    if fewest < _MIN_POINTS:
        return Meeting(len(places), fewest, None)
    a, b = (cloud - chosen.mean(axis=0) for cloud in clouds)
    as_they_are, *turned = (_agreements(a, b) + _agreements(b, a)[[0, *_OPPOSITE]]) / 2
    return Meeting(len(places), fewest, float(as_they_are), float(max(turned) - as_they_are))


def _places(mine: SegmentMap, theirs: SegmentMap) -> Float64:
    """Return positions of either trajectory near the other, relative to the origin of ``mine``."""
    a, b = (part.trajectory[:, :3, 3] - mine.origin for part in (mine, theirs))
    if not (len(a) and len(b)):
        return np.empty((0, 3))
    return np.concatenate([_near(a, b), _near(b, a)])


def _near(path: Float64, other: Float64) -> Float64:
    """Return the positions of a trajectory near another one."""
    squeezed = np.array([1.0, 1.0, MEET_M / MEET_HEIGHT_M])
    distances, _ = cKDTree(other * squeezed).query(path * squeezed, distance_upper_bound=MEET_M)
    near: Float64 = path[np.isfinite(distances)]
    return near


def _around(points: Float64, places: Float64) -> Float64:
    """Return the points around the places."""
    low, high = places.min(axis=0) - _AROUND_M, places.max(axis=0) + _AROUND_M
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if not len(points):
        return points
    distances, _ = cKDTree(places).query(points, distance_upper_bound=_AROUND_M)
    return points[np.isfinite(distances)]


def _agreements(points: Float64, others: Float64) -> Float64:
    """Return the agreement of points as they are, and turned by ``_TURNS_DEG`` about the origin."""
    tree = cKDTree(others)
    some = points[:: len(points) // _MAX_POINTS + 1]

    def share(points: Float64) -> float:
        distances, _ = tree.query(points, distance_upper_bound=_NEAR_M)
        return float(np.isfinite(distances).mean())

    angles = np.arange(8) * np.pi / 4
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(8)])
    by_chance = np.mean([share(some + m * way) for way, m in zip(ring, _SHIFTS_M * 4, strict=True)])
    turns = [geometry.yaw_transform(np.radians(turn)) for turn in (0.0, *_TURNS_DEG)]
    shares = np.array([share(geometry.transform(T, some)) for T in turns])
    agreements: Float64 = (shares - by_chance) / max(1 - by_chance, 1e-3)
    return agreements
