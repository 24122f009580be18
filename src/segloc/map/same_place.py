"""Whether two maps are of one place in one frame, judged where their paths meet.

Where both were driven, their clouds must agree better than they do when one of them is shifted by
a few metres: ground, and streets alike, agree with anything. So ``agreement`` is the share of the
points with a point of the other cloud nearby, as the part of the way from its chance value to one.
And no turn of one of them by some degrees may agree much better: small places still agree somewhat
when they are turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import geometry
from ..errors import MapMismatch
from ..types import Float64
from .georeference import Georeference
from .segment_map import SegmentMap

MEET_M, MEET_HEIGHT_M = 5.0, 2.0
"""Paths meet where they come this near: about a street's width, and less than a storey."""

MIN_AGREEMENT = 0.5
MOST_GAIN = 0.1
"""Measured: docs/how-to/align.md has the figures."""

_AROUND_M = 15.0  # what both saw well
_NEAR_M = 1.0  # positions of two passes agree to about a metre
_SHIFTS_M = (4.0, 6.0)
_TURNS_DEG = (-15.0, -10.0, -5.0, 5.0, 10.0, 15.0)
_OPPOSITE = tuple(1 + _TURNS_DEG.index(-turn) for turn in _TURNS_DEG)
_MAX_POINTS = 20_000
_MIN_POINTS = 200
_MAX_MEETINGS = 300


@dataclass(frozen=True)
class Meeting:
    """Where two maps meet.

    Attributes
    ----------
    places : int
        Poses of either path that come near the other's.
    points : int
        Points compared there; too few tell nothing.
    agreement : float or None
        0 by chance, 1 if every point is in both clouds; None where too few points were compared.
    gain : float
        How much larger it is, at most, with one of the clouds turned by 5 to 15 degrees.
    """

    places: int
    points: int
    agreement: float | None
    gain: float = 0.0


def check_same_place(mine: SegmentMap, theirs: SegmentMap, *, elsewhere: bool = False) -> None:
    """Refuse two maps that cannot be of one place in one frame.

    Maps without a path, a cloud or a segment cannot be judged and pass, and so do maps with too few
    points where they meet.

    Parameters
    ----------
    mine, theirs : SegmentMap
    elsewhere : bool
        Whether maps that meet nowhere are allowed: two places in one frame.

    Raises
    ------
    MapMismatch
        If they meet nowhere, or do and their clouds disagree.
    """
    check_same_frame(mine, theirs)
    if not all(len(part.trajectory) and len(part.cloud) for part in (mine, theirs)):
        return
    found = meeting(mine, theirs)
    if not found.places:
        if elsewhere:
            return
        raise MapMismatch(
            f"the paths of the maps meet nowhere (within {MEET_M:g} m): they are of two places, or "
            "in two frames; --elsewhere joins two places of one frame"
        )
    if found.agreement is not None and found.agreement < MIN_AGREEMENT:
        raise MapMismatch(
            f"the maps are in two frames: where their paths meet ({found.places} poses), their "
            f"clouds agree little more than by chance ({found.agreement:.2f} < {MIN_AGREEMENT:g})"
        )
    if found.agreement is not None and found.gain > MOST_GAIN:
        raise MapMismatch(
            f"the maps are in two frames: where their paths meet ({found.places} poses), their "
            f"clouds agree much better if one is turned by some degrees ({found.agreement:.2f}, "
            f"and {found.agreement + found.gain:.2f})"
        )


def check_same_frame(mine: SegmentMap, theirs: SegmentMap) -> None:
    """Refuse maps that say that they lie at two places on the globe.

    Raises
    ------
    MapMismatch
        If both have a georeference, and these differ.
    """
    named = [Georeference.of(each.metadata) for each in (mine, theirs)]
    if None not in named and named[0] != named[1]:
        raise MapMismatch(f"the maps are in two frames: {named[0]}, and {named[1]}")


def meets(mine: SegmentMap, theirs: SegmentMap) -> bool:
    """Whether the paths of two maps meet."""
    return len(_places(mine, theirs)) > 0


def meeting(mine: SegmentMap, theirs: SegmentMap) -> Meeting:
    """How well two maps agree where their paths meet."""
    origin = mine.origin  # coordinates of UTM would cost precision
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
    """Positions of either path that are near the other's, relative to the origin of ``mine``."""
    a, b = (part.trajectory[:, :3, 3] - mine.origin for part in (mine, theirs))
    if not (len(a) and len(b)):
        return np.empty((0, 3))
    return np.concatenate([_near(a, b), _near(b, a)])


def _near(path: Float64, other: Float64) -> Float64:
    """The positions of a path that come near another path."""
    squeezed = np.array([1.0, 1.0, MEET_M / MEET_HEIGHT_M])
    distances, _ = cKDTree(other * squeezed).query(path * squeezed, distance_upper_bound=MEET_M)
    near: Float64 = path[np.isfinite(distances)]
    return near


def _around(points: Float64, places: Float64) -> Float64:
    """The points around the places."""
    low, high = places.min(axis=0) - _AROUND_M, places.max(axis=0) + _AROUND_M
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if not len(points):
        return points
    distances, _ = cKDTree(places).query(points, distance_upper_bound=_AROUND_M)
    return points[np.isfinite(distances)]


def _agreements(points: Float64, others: Float64) -> Float64:
    """Of points as they are, and turned about the origin by ``_TURNS_DEG``."""
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
