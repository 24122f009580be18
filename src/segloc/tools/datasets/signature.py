"""Recognise the sensor of a scan by the elevation angles of its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ... import geometry
from ...types import Float64, Recording

PUSH_BROOM = "a sweep of one plane"
_BIN_DEG = 0.02
_WIDE_DEG, _AROUND = 0.05, 61  # bin size for comparing axes, and bins averaged
_SHARP, _SHARPER = 3.0, 2.0
_MIN_POINTS = 2000  # to compare axes
_MAX_COUNTED = 48  # beams; more are too close to be separated reliably
_BEAM_RATIO = 1.5  # beyond it, beam counts differ
_SHARPNESS_RATIO = 2.5  # beyond it, a pattern of beams has come or gone
_MAX_LOW_DEG = 4.0  # between the lowest beams, which hit the ground in every scan
_MAX_BOTTOM_DEG = 10.0  # between the lowest points of clouds without separate beams
_STEEP_DEG = -35.0  # below any beam of a single turn; accumulated clouds reach lower


@dataclass(frozen=True)
class Signature:
    """Beam pattern of a sensor."""

    beams: int  # distinct elevation angles; 1 for a sweep of one plane
    low_deg: float  # lowest elevation
    high_deg: float  # highest elevation
    sharpness: float = 0.0  # how distinct the elevations are; about 1 without separate beams

    @property
    def many(self) -> bool:
        """True if there are more beams than can be counted, or none are separate."""
        return self.beams > 1 and (self.beams > _MAX_COUNTED or self.sharpness < _SHARP)

    def is_like(self, other: Signature) -> bool:
        """Return whether both can be of one sensor.

        Beams are compared only where they are distinct: the peaks among the elevations of fused,
        thinned or accumulated clouds are due to chance.
        """
        if 1 in (self.beams, other.beams):
            return self.beams == other.beams
        below = abs(self.low_deg - other.low_deg)
        blurred, sharp = sorted((self.sharpness, other.sharpness))
        if sharp < _SHARP:
            steep = max(self.low_deg, other.low_deg) < _STEEP_DEG
            return steep or below < _MAX_BOTTOM_DEG
        if blurred < _SHARP:
            return sharp < _SHARPNESS_RATIO * blurred
        fewer, more = sorted((self.beams, other.beams))
        same_beams = fewer > _MAX_COUNTED or more <= _BEAM_RATIO * max(fewer, 4)
        return same_beams and below < _MAX_LOW_DEG

    def __str__(self) -> str:
        if self.beams == 1:
            return "2D, one plane"
        span = f"{self.low_deg:.1f} to {self.high_deg:.1f} deg"
        if self.many:
            return f"3D, many or no separate beams, {span}"
        return f"3D, {self.beams} beams, {span}"


def signature(points: NDArray[np.floating]) -> Signature | None:
    """Return the signature of a cloud (N, 3); None for fewer than three points."""
    if len(points) < 3:
        return None
    cloud = points.astype(np.float64)
    if geometry.in_one_plane(cloud):
        return Signature(1, 0.0, 0.0)
    count, low, high, sharpness = beams(cloud)
    return Signature(max(count, 2), low, high, sharpness)


def sensor_of(recording: Recording, sample: int = 5) -> str:
    """Classify the sensor by the largest of ``sample`` scans; "" if all are empty.

    Return "a sweep of one plane", "few beams" (less than 48) or "many beams". This is coarser than
    :func:`inspect`, so that sessions of one sensor agree.

    Raise DatasetError if a scan cannot be read.
    """
    clouds = [recording.scan(i).points for i in geometry.spread(len(recording), sample)]
    found = signature(max(clouds, key=len, default=np.empty((0, 3), np.float32)))
    if found is None:
        return ""
    if found.beams == 1:
        return PUSH_BROOM
    return "many beams" if found.many else "few beams"


def turns_about_z(points: NDArray[np.floating]) -> bool:
    """Return whether distinct beams turn about z."""
    cloud = points.astype(np.float64)
    return beam_axis(cloud) == 2 and _sharpness(_elevations(cloud)) >= _SHARP


def beam_axis(points: NDArray[np.floating]) -> int:
    """Return the axis about which the beams turn: 0, 1 or 2 for x, y or z.

    It is z, unless elevations about another axis are far more distinct.
    """
    cloud = points.astype(np.float64)
    if len(cloud) < _MIN_POINTS:
        return 2
    sharp = [_sharpness(_elevations(cloud, axis)) for axis in range(3)]
    other = int(np.argmax(sharp[:2]))
    return other if sharp[other] > max(_SHARP, _SHARPER * sharp[2]) else 2


def _sharpness(angles: Float64) -> float:
    """Return how distinct elevations are; about 1 if evenly spread, for any number of points.

    16 or 32 beams have 13 to 30 about their own axis and at most 1.5 about others.
    """
    counts, _ = np.histogram(angles, bins=np.arange(-90.0, 90.0 + _WIDE_DEG, _WIDE_DEG))
    around = np.convolve(counts, np.full(_AROUND, 1.0 / _AROUND), "same")
    return float((counts * (counts - 1.0)).sum() / max(1.0, float(counts @ around)))


def _elevations(cloud: Float64, axis: int = 2) -> Float64:
    """Return elevation angles about an axis [deg], except of near points."""
    reach = np.linalg.norm(cloud, axis=1)
    far = cloud[reach > np.median(reach) / 4]  # beam origins distort near points
    across = np.delete(far, axis, axis=1)
    return np.asarray(np.degrees(np.arctan2(far[:, axis], np.hypot(*across.T))))


def beams(cloud: Float64) -> tuple[int, float, float, float]:
    """Return the number of elevation angles, the lowest and highest [deg], and their sharpness.

    Angles are about the axis of the beams.
    """
    angles = _elevations(cloud, beam_axis(cloud))
    counts, _ = np.histogram(angles, bins=np.arange(-90.0, 90.0 + _BIN_DEG, _BIN_DEG))
    weights = np.exp(-0.5 * (np.arange(-4, 5) / 1.5) ** 2)
    smooth = np.convolve(counts, weights / weights.sum(), "same")
    level = 0.15 * np.percentile(smooth[smooth > 0], 90)
    middle = smooth[1:-1]
    peaks = (middle > smooth[:-2]) & (middle >= smooth[2:]) & (middle > level)
    return int(peaks.sum()), float(angles.min()), float(angles.max()), _sharpness(angles)
