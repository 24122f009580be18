"""Checks of a finished cloud before the long work: unit, steps, axes and tilt of its frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from .. import _native, geometry
from ..errors import DatasetError
from ..frontend.gravity import AttitudeConfig, angle_deg
from ..frontend.local_cloud import LocalCloudConfig
from ..frontend.surfaces import Surfaces
from ..frontend.tilt import Tilt, frame_tilt, level_transform
from ..system.checks import MAX_LOCAL_METRES
from ..types import Float32, Float64, MemoryRecording, Pose

Points = NDArray[np.floating]

MAX_TILT_DEG = 10.0
"""Clouds that are tilted by more are refused; of smaller tilts there is a note."""
UNCHECKED = "--unchecked (check=False) builds the map anyway"
LEVEL = "--level (mapping.level) turns the cloud"

_MAX_SPACING_M = 1.5  # of a cloud in which objects can be told apart
_USUAL_SPACING_M, _USUAL_HEIGHT_M = (0.1, 1.0), (10.0, 0.8)  # with the spread of the logarithm
_UNITS = (("millimetres", 1000.0), ("centimetres", 100.0))
_SAMPLE = 1000
_MAX_STEP_M = 0.1
"""Steps of the coordinates that are coarser would show in the map, whose voxels are as large."""
_STEP_SAMPLE = 200_000


@dataclass
class Dropped:
    """Numbers of points that are no part of a cloud."""

    not_finite: int = 0
    zeros: int = 0
    far: int = 0

    def __str__(self) -> str:
        parts = [
            (self.not_finite, "not finite"),
            (self.zeros, "exactly 0, 0, 0"),
            (self.far, f"more than {MAX_LOCAL_METRES / 1000:g} km from the others"),
        ]
        return ", ".join(f"{count} {text}" for count, text in parts if count)


def unit_fault(points: Float64) -> str | None:
    """Return the fault of points (N, 3) that are too far apart for metres; None if there is none.

    Feet cannot be told from metres: rooms and streets of three times the size exist.
    """
    near = (points - np.median(points, axis=0)) / _UNITS[0][1]  # the kernel takes at most 1e5 m
    near = near[np.abs(near).max(axis=1) < MAX_LOCAL_METRES].astype(np.float32)
    least = _MAX_SPACING_M / _UNITS[0][1]
    spacing = _native.point_spacing(np.ascontiguousarray(near), least, _SAMPLE) * _UNITS[0][1]
    if spacing <= _MAX_SPACING_M:
        return None
    height = float(_extent(points).min())

    def misfit(count: float) -> float:
        pairs = (spacing, _USUAL_SPACING_M), (max(height, 1e-3), _USUAL_HEIGHT_M)
        return sum((math.log(m / count / usual) / spread) ** 2 for m, (usual, spread) in pairs)

    name, count = min(_UNITS, key=lambda unit: misfit(unit[1]))
    return (
        f"neighbouring points are {spacing:.3g} m apart, so the cloud is probably in {name}: "
        f"divide it by {count:g}"
    )


def step_fault(points: Points) -> str | None:
    """Return the fault of coordinates (N, >=3) of which digits are lost; None if there is none.

    float32 has 24 bits: a northing of 5 400 000 m comes in steps of 0.5 m.
    """
    few = points[:: 1 + len(points) // _STEP_SAMPLE, :3].astype(np.float64)
    for axis, values in zip("xyz", few.T, strict=True):
        largest = float(np.median(np.abs(values)))
        exact = float(np.spacing(np.float32(largest)))
        if exact <= _MAX_STEP_M:
            continue
        steps = np.diff(np.unique(values))
        if len(steps) and (step := float(steps.min())) >= exact:
            return (
                f"{axis} comes in steps of {step:.3g} m: coordinates of {largest:.0f} m lost "
                "digits, as in float32: save the cloud in float64, or subtract an offset before it "
                "is saved"
            )
    return None


def _extent(points: Points) -> Float64:
    """Return the extent of nearly all points (N, 3) along each axis [m], (3,)."""
    few = points[:: 1 + len(points) // _STEP_SAMPLE]
    low, high = np.percentile(few, [2, 98], axis=0)
    return np.asarray(high - low, dtype=np.float64)


_TURNS: dict[str, tuple[list[list[float]], str]] = {
    "-z": ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], ""),
    "+z": (
        [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        "the z axis points down: change the signs of y and z",
    ),
    "+y": (
        [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
        "the axes are a camera's (x right, y down, z forward): write z, -x, -y in place of x, y, z",
    ),
    "-y": (
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        "the y axis points up: write z, x, y in place of x, y, z",
    ),
    "+x": (
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        "the x axis points down: write z, y, -x in place of x, y, z",
    ),
    "-x": (
        [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
        "the x axis points up: write y, z, x in place of x, y, z",
    ),
}
"""By the direction of the ground: the rotation of the axes that makes z point up, in words, too."""
_ALONG = 0.94  # cosine of 20 degrees, between a normal and its direction
_STANDS_M, _ASIDE_M = 0.5, 3.0  # of what stands on flat places: least height, most distance
_AROUND = 32  # of these places; fewer are the roof of a car, or the top of a box
_MIN_SHARE, _MOST = 0.1, 0.7  # of flat places across a direction
_SURE, _UNSURE, _TELLING = 0.6, 0.6, 0.3  # of the balance of what is above and below
_LOW, _LOWEST = 0.5, 0.35  # extent along the vertical, as a share of that along z, and of all
_MIN_LOWS, _MAX_LAND_SPREAD_DEG = 50, 1.0  # lowest points that show how land lies, of both halves


def is_tilted(tilt: Tilt | None) -> TypeGuard[Tilt]:
    """Return whether a frame is clearly not level."""
    return tilt is not None and tilt.is_significant and tilt.tilt_deg > MAX_TILT_DEG


@dataclass(frozen=True)
class _Direction:
    """A direction that may be the vertical of a cloud.

    Attributes
    ----------
    axis : str
    up : (3,) float64
        Unit vector near the axis.
    tilt : Tilt or None
        Of the direction against its axis; None if too few walls show it.
    share : float
        Share of the flat places that lie across it.
    balance : float
        From 1 if all things stand on these places to -1 if all hang from them.
    extent_m : float
    """

    axis: str
    up: Float64
    tilt: Tilt | None
    share: float
    balance: float
    extent_m: float

    @property
    def is_tilted(self) -> bool:
        """Whether the direction is clearly not the axis."""
        return is_tilted(self.tilt)

    def is_rather_up(self, z: _Direction, third: _Direction) -> bool:
        """Return whether this is clearly the vertical, and not the direction near z.

        Sites are wider than high. Things stand on the ground, and nothing on a wall.
        """
        if self.share < _MIN_SHARE or self.extent_m > _LOW * z.extent_m:
            return False
        is_lowest = self.extent_m < _LOWEST * min(z.extent_m, third.extent_m)
        return is_lowest or abs(self.balance) > _SURE or z.is_tilted


@dataclass(frozen=True)
class CloudFrame:
    """How the frame of a cloud lies.

    Attributes
    ----------
    tilt : Tilt or None
        Of the z axis; None if it is not up at all, or too few walls show it.
    fault : str
        What is wrong with its axes, or "".
    T_level_cloud : (4, 4) float64 or None
        Rotation to a level frame; None if the vertical is not known.
    land : Tilt or None
        Of the lie of the land, if the walls do not show the vertical: it may be a slope.
    """

    tilt: Tilt | None
    fault: str = ""
    T_level_cloud: Pose | None = None
    land: Tilt | None = None

    def require_up(self) -> None:
        """Refuse a cloud whose z axis is clearly not up, by a :class:`DatasetError`."""
        if self.fault:
            remedy = UNCHECKED if self.T_level_cloud is None else f"{LEVEL}, {UNCHECKED}"
            raise DatasetError(f"{self.fault}; {remedy}")
        if is_tilted(self.tilt):
            raise DatasetError(
                f"the cloud is tilted by {self.tilt.tilt_deg:.1f} degrees, as its walls show, more "
                f"than {MAX_TILT_DEG:g}: {LEVEL}, {UNCHECKED}"
            )


def cloud_frame(
    views: Sequence[Float32], eyes: Float64, lows: Float64, attitude: AttitudeConfig
) -> CloudFrame:
    """Tell how the frame of a cloud lies, by its floors and walls, or else by its lowest points.

    Parameters
    ----------
    views : list of (N, 3) float32
        Parts of the cloud, each around its own middle.
    eyes : (K, 3) float64
        These middles.
    lows : (M, 3) float64
        The lowest points, one of each part of the cloud.
    attitude : AttitudeConfig
    """
    measure = _Measure(views, eyes, attitude)
    z = measure.direction("z")
    if z.share < _MOST and abs(z.balance) < _UNSURE:
        x, y = measure.direction("x"), measure.direction("y")
        for each, third in ((x, y), (y, x)):
            if each.is_rather_up(z, third):
                return _turn(each)
    if z.balance < -_SURE and z.share > _MIN_SHARE:
        return _turn(z)
    land = _land_tilt(lows) if z.tilt is None else None
    tilt = z.tilt or land
    T_level_cloud = None if tilt is None else level_transform(tilt, np.eye(4))
    return CloudFrame(z.tilt, "", T_level_cloud, land)


def _land_tilt(lows: Float64) -> Tilt | None:
    """Return the tilt of the plane of the lowest points; None if they lie in none."""
    if len(lows) < _MIN_LOWS:
        return None
    first, second, up = (_upright_to(part) for part in (lows[::2], lows[1::2], lows))
    spread = angle_deg(first, second)
    return Tilt(up, spread) if spread < _MAX_LAND_SPREAD_DEG else None


def _upright_to(points: Float64) -> Float64:
    """Return the unit vector normal to the plane of points (N, 3), of which some lie above."""
    x, y, z = (points - np.median(points, axis=0)).T
    level = np.stack([x, y, np.ones_like(x)])

    def above(plane: Float64) -> Float64:
        return np.asarray(z - plane @ level)

    east, north, _ = least_squares(above, np.zeros(3), loss="soft_l1").x
    up = np.array([-east, -north, 1.0])
    return np.asarray(up / np.linalg.norm(up))


class _Measure:
    """Measures directions that may be the vertical of a cloud."""

    def __init__(self, views: Sequence[Float32], eyes: Float64, attitude: AttitudeConfig) -> None:
        self._views, self._eyes = views, eyes
        self._config = LocalCloudConfig(attitude=attitude)
        self._seen = [found for points in views if (found := Surfaces.of(points)) is not None]
        few = [points[:: 1 + len(points) // _SAMPLE] for points in views]
        self._spread = np.concatenate([p + eye for p, eye in zip(few, eyes, strict=True)])

    def direction(self, axis: str) -> _Direction:
        """Measure the direction near an axis that is across floors and along walls."""
        turn = np.array(_TURNS[f"-{axis}"][0], np.float64)
        views = [np.asarray(points @ turn.T, np.float32) for points in self._views]
        poses = np.array([geometry.rigid(np.eye(3), turn @ eye) for eye in self._eyes])
        tilt = frame_tilt(MemoryRecording(views, poses), self._config, by_floors=True)
        up = turn.T[:, 2] if tilt is None or not tilt.is_significant else turn.T @ tilt.up
        low, high = np.percentile(self._spread @ up, [2, 98])
        return _Direction(axis, up, tilt, *self._surfaces(up), float(high - low))

    def _surfaces(self, up: Float64) -> tuple[float, float]:
        """Return share and balance of the flat places across a direction."""
        flat = across = above = below = 0
        beside = geometry.upright(up)[:2, :3].T
        for surfaces in self._seen:
            places = surfaces.places[np.abs(surfaces.normals @ up) > _ALONG]
            flat, across = flat + len(surfaces.places), across + len(places)
            if not len(places):
                continue
            levels = np.append(places @ up, np.nan)
            tree, at = cKDTree(places @ beside), surfaces.seen @ beside
            nearest = np.asarray(tree.query(at, k=_AROUND, distance_upper_bound=_ASIDE_M)[1])
            found = nearest[:, 0] < len(places)
            height = surfaces.seen[found] @ up - np.nanmedian(levels[nearest[found]], axis=1)
            above += int((height > _STANDS_M).sum())
            below += int((height < -_STANDS_M).sum())
        return across / max(flat, 1), (above - below) / max(above + below, 1)


def _turn(found: _Direction) -> CloudFrame:
    """Return the frame of a cloud with another direction up than +z."""
    if abs(found.balance) < _TELLING:
        ways = " or ".join(_TURNS[side + found.axis][1].partition(": ")[2] for side in "+-")
        what = f"the z axis is not up: floor and ceiling lie across {found.axis}"
        return CloudFrame(None, f"{what}, and which is which cannot be told: {ways}")
    sign = 1.0 if found.balance > 0 else -1.0
    ground = ("-" if sign > 0 else "+") + found.axis
    matrix, text = _TURNS[ground]
    turn, up = np.array(matrix, np.float64), sign * found.up
    spread = 0.0 if found.tilt is None else found.tilt.spread_deg
    fine = level_transform(Tilt(turn @ up, spread), np.eye(4))
    fault = f"the ground lies towards {ground}: {text}"
    return CloudFrame(None, fault, fine @ geometry.rigid(turn, np.zeros(3)))
