"""The map of landmarks: detections from several poses, each landmark once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from segloc.errors import MapFormatError, SeglocError
from segloc.map import file as mapfile
from segloc.system.checks import MAX_METRES, check_finite, checked_pose, checked_rows
from segloc.types import Float64, Int64

from .config import LandmarkConfig
from .landmarks import Landmarks, nearest

DESCRIPTOR, FINGERPRINT = "landmarks", "landmarks-1"
_VOXEL_M = 0.3  # of the cloud, which has no points
_SQUEEZED = np.array([1.0, 1.0, 0.2])
"""Scale of distances: the height of a stem's foot is less certain than its position."""


@dataclass(frozen=True)
class LandmarkMap:
    """Landmarks in one frame with a vertical z axis. Built by :class:`LandmarkMapper` or loaded.

    Attributes
    ----------
    positions : (M, 3) float64
        Means of all views, metres.
    axes : (M, 3) float64
    diameters : (M,) float64
        Metres.
    views : (M,) int64
        Number of views of each.
    trajectory : (V, 4, 4) float64
        T_map_sensor of each view.

    Raises
    ------
    InvalidScan
        If shapes do not fit, or a value is not finite or too large.
    """

    positions: Float64
    axes: Float64
    diameters: Float64
    views: Int64
    trajectory: Float64

    def __post_init__(self) -> None:
        positions = checked_rows(self.positions, "positions", (-1, 3), np.float64)
        check_finite(positions, "positions", MAX_METRES)
        count = len(positions)
        columns = {
            "positions": positions,
            "axes": checked_rows(self.axes, "axes", (count, 3), np.float64),
            "diameters": checked_rows(self.diameters, "diameters", (count,), np.float64),
            "views": checked_rows(self.views, "views", (count,), np.int64),
            "trajectory": checked_rows(self.trajectory, "trajectory", (-1, 4, 4), np.float64),
        }
        for name, rows in columns.items():
            object.__setattr__(self, name, rows)

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def build(
        cls, views: Iterable[tuple[Landmarks, ArrayLike]], config: LandmarkConfig | None = None
    ) -> LandmarkMap:
        """Build a map from landmarks detected at known poses.

        Parameters
        ----------
        views : iterable of (Landmarks, (4, 4) array)
            Landmarks of each view, and T_map_sensor; the map's z axis is vertical.
        config : LandmarkConfig, optional
        """
        mapper = LandmarkMapper(config)
        for landmarks, T_map_sensor in views:
            mapper.add(landmarks, T_map_sensor)
        return mapper.map()

    def save(self, path: str | Path) -> None:
        """Write a ``.segmap`` file atomically.

        Raises
        ------
        SeglocError
        """
        count = len(self)
        arrays: dict[str, mapfile.Array] = {
            "origin": np.zeros(3),
            "centroids": self.positions,
            "stamps": np.zeros(count),
            "trajectory": self.trajectory,
            "vectors": np.column_stack([self.axes, self.diameters]),
            "cloud": np.empty((0, 3), np.float32),
            "sizes": np.minimum(self.views, np.iinfo(np.int32).max),
            "session": np.zeros(count),
        }
        mapfile.write(path, mapfile.Contents(arrays, DESCRIPTOR, FINGERPRINT, _VOXEL_M, {}))

    @classmethod
    def load(cls, path: str | Path) -> LandmarkMap:
        """Read a file that :meth:`save` wrote.

        Raises
        ------
        MapFormatError
            If it cannot be read, or is not a map of landmarks.
        """
        contents = mapfile.read(path)
        if contents.fingerprint != FINGERPRINT or contents.arrays["vectors"].shape[1] != 4:
            raise MapFormatError(
                f"{path}: a map of {contents.descriptor}, not of landmarks: "
                "pass it to `segloc localize`, or load it by SegmentMap.load(path)"
            )
        arrays = contents.arrays
        vectors = arrays["vectors"].astype(np.float64)
        views = arrays["sizes"].astype(np.int64)
        return cls(arrays["centroids"], vectors[:, :3], vectors[:, 3], views, arrays["trajectory"])


class LandmarkMapper:
    """Builds a map of landmarks view by view.

    Parameters
    ----------
    config : LandmarkConfig, optional
    """

    def __init__(self, config: LandmarkConfig | None = None) -> None:
        self._config = config or LandmarkConfig()
        self._merger = Merger(self._config.merge_radius)
        self._trajectory: list[Float64] = []

    def add(self, landmarks: Landmarks, T_map_sensor: ArrayLike) -> None:
        """Add the landmarks of one view.

        Raises
        ------
        SeglocError
            If the arguments are not landmarks and a rigid pose.
        """
        if not isinstance(landmarks, Landmarks):
            raise SeglocError(f"a view must be Landmarks, not {type(landmarks).__name__}")
        T = checked_pose(T_map_sensor, "T_map_sensor")
        self._merger.add(landmarks.transform(T))
        self._trajectory.append(T)

    def map(self) -> LandmarkMap:
        """Return the map of all landmarks with enough views."""
        columns, views = self._merger.merge()
        keep = views >= self._config.min_views
        columns = columns[keep]
        trajectory = np.array(self._trajectory).reshape(-1, 4, 4)
        return LandmarkMap(columns[:, :3], columns[:, 3:6], columns[:, 6], views[keep], trajectory)


class Merger:
    """Merges nearby detections of several views into means.

    Parameters
    ----------
    radius : float
        Largest distance of a detection from its mean [m]; five times as far along z.
    """

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self._means = np.empty((0, 7))
        self._views = np.empty(0, np.int64)

    def add(self, columns: Float64) -> None:
        """Add the landmarks of one view; each mean takes the nearest one.

        Parameters
        ----------
        columns : (N, 7) float64
            Positions, axes and diameters, map frame.
        """
        rows, known = self._nearest(columns)
        self._views[known] += 1
        self._means[known] += (columns[rows] - self._means[known]) / self._views[known, None]
        new = np.ones(len(columns), bool)
        new[rows] = False
        self._means = np.concatenate([self._means, columns[new]])
        self._views = np.concatenate([self._views, np.ones(int(new.sum()), np.int64)])

    def merge(self) -> tuple[Float64, Int64]:
        """Return means, (M, 7), and numbers of views, (M,), after joining means within the radius.

        The mean with most views absorbs the others.
        """
        means, views = self._means.copy(), self._views.copy()
        alive = np.ones(len(views), bool)
        for keeper, others in self._neighbours():
            if not alive[keeper]:
                continue
            taken = [other for other in others if alive[other]]
            alive[taken] = False
            group = [keeper, *taken]
            means[keeper] = np.average(self._means[group], axis=0, weights=self._views[group])
            views[keeper] = self._views[group].sum()
        return _normalise(means[alive]), views[alive]

    def _nearest(self, columns: Float64) -> tuple[Int64, Int64]:
        """Return the landmarks with a mean nearby, and that mean; the nearest landmark of each."""
        if not len(self._means) or not len(columns):
            return np.empty(0, np.int64), np.empty(0, np.int64)
        tree = cKDTree(self._means[:, :3] * _SQUEEZED)
        distance, mean = nearest(tree, columns[:, :3] * _SQUEEZED, within=self._radius)
        rows = np.flatnonzero(np.isfinite(distance))
        rows = rows[np.argsort(distance[rows], kind="stable")]
        found, first = np.unique(mean[rows], return_index=True)
        return rows[first], found.astype(np.int64)

    def _neighbours(self) -> list[tuple[int, list[int]]]:
        """Return means with others within the radius, that with most views first."""
        if not len(self._means):
            return []
        tree = cKDTree(self._means[:, :3] * _SQUEEZED)
        around: dict[int, list[int]] = {}
        for a, b in sorted(tree.query_pairs(self._radius)):
            around.setdefault(a, []).append(b)
            around.setdefault(b, []).append(a)
        order = sorted(around, key=lambda k: (-self._views[k], k))
        return [(k, around[k]) for k in order]


def _normalise(means: Float64) -> Float64:
    length = np.linalg.norm(means[:, 3:6], axis=1, keepdims=True)
    means[:, 3:6] /= np.maximum(length, 1e-9)
    return means
