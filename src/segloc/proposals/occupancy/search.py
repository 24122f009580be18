"""What a query shows standing, found standing in a map."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from ... import _native, geometry
from ...frontend.segmentation import Segmentation, SegmentationConfig
from ...prior import Prior
from ...types import Candidate, Float32, Float64, Int64
from ..proposer import Proposals, Query
from .config import OccupancyConfig
from .ground import Ground, cells_of, nearest_of
from .storeys import storeys
from .view import HEIGHTS_M, View, evenly, slices_of, view_of

LEVELS = (4, 5, 6)
"""Of windows: the widest are 4, 8 or 16 m with cells of half a metre."""
FEWEST_COLUMNS = 64
"""Of a query in a large map: with fewer, wider windows tell more."""
FEWEST_OCCUPIED = 20
"""A query that shows less standing says nothing."""
SEPARATION_M, SEPARATION_DEG = 2.0, 9.0
"""Of candidates: nearer ones are refined to the same pose."""


class OccupancyProposer:
    """Proposes poses at which what a query shows standing stands in the map, too.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's, relative to ``origin``; with its ground.
    origin : (3,) float64
    trajectory : (V, 4, 4) float64
        Along which the map was recorded. Without one the sensor may be wherever the cloud is.
    config : OccupancyConfig, optional
    segmentation : SegmentationConfig, optional
        What ground is.

    Notes
    -----
    What it needs of the map is made when it is first asked, in 0.1 to 1 s: about 7 MB for a
    kilometre of street. A map too wide for it has no candidates. Each storey of a building is
    searched by itself.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        trajectory: Float64,
        config: OccupancyConfig | None = None,
        segmentation: SegmentationConfig | None = None,
    ) -> None:
        self.config = config or OccupancyConfig()
        self._cloud, self._origin = cloud, origin
        self._path = trajectory[:, :3, 3] - origin
        self._segmentation = segmentation or SegmentationConfig()
        self._maps: list[_OccupancyMap] | None = None

    exhaustive = True

    def propose(self, query: Query, prior: Prior | None = None) -> Proposals:
        """Propose poses by the cells that are occupied or free."""
        return Proposals(self.candidates(query.scene, prior))

    def candidates(self, scene: Segmentation, near: Prior | None = None) -> list[Candidate]:
        """Candidate poses T_map_local, best first, each with its ``fit``; none if it shows little.

        Parameters
        ----------
        scene : Segmentation
            Of a local cloud.
        near : Prior, optional
            Where poses are looked for.
        """
        if self._maps is None:  # threads that ask at once make the same
            self._maps = self._prepared()
        view = view_of(scene, self.config, self._segmentation)
        found = [pose for each in self._maps for pose in each.search(view, self._origin, near)]
        found.sort(key=lambda pose: -pose[4])
        poses = [(geometry.yaw_transform(yaw, (x, y, z)), fit) for x, y, z, yaw, fit in found]
        return [Candidate(T, 0, fit) for T, fit in poses if near is None or near.holds(T)]

    def _prepared(self) -> list[_OccupancyMap]:
        """A map of each storey; all storeys together are as much work as one would be."""
        parts = list(storeys(self._cloud, self._path))
        config = self.config.model_copy(update={"work": self.config.work // len(parts)})
        return [_OccupancyMap(*part, config, self._segmentation) for part in parts]


class _OccupancyMap:
    """A map, made ready to be searched."""

    def __init__(
        self,
        cloud: Float32,
        path: Float64,
        config: OccupancyConfig,
        segmentation: SegmentationConfig,
    ) -> None:
        self._config = config
        self._windows = 0
        self._native: _native.PoseSearch | None = None
        with suppress(ValueError):  # wider than the kernels' tables: nothing is found
            self._prepare(cloud, path, segmentation)

    def _prepare(self, cloud: Float32, path: Float64, segmentation: SegmentationConfig) -> None:
        """With the narrowest of the widest windows that the work allows for."""
        config = self._config
        self._ground = Ground(cloud, path, segmentation)
        heights = cloud[:, 2] - self._ground.below_cloud
        standing = heights > HEIGHTS_M[0]
        if not standing.any():
            return
        points, slices = cloud[standing], slices_of(heights[standing])
        for levels in LEVELS:
            width = config.cell * 2 ** (levels - 1)
            near = path[:, :2]
            roots = _along(near, width, config.reach_m) if len(path) else _under(cloud, width)
            self._windows = len(roots)
            if self._windows * FEWEST_COLUMNS <= config.work:
                farthest = config.range_m + config.cell
                self._native = _native.PoseSearch(
                    points, slices, roots, config.cell, levels, farthest
                )
                return

    def search(
        self, view: View, origin: Float64, near: Prior | None
    ) -> Iterator[tuple[float, float, float, float, float]]:
        """Position in the map, yaw and fit of the best poses."""
        config, columns, slices = self._config, view.columns, view.slices
        if self._native is None or len(columns) < FEWEST_OCCUPIED:
            return
        most = min(config.columns, config.work // self._windows)
        chosen = evenly(len(columns), most)
        columns, slices = columns[chosen], slices[chosen]
        poses, scores = self._native.search(
            columns,
            slices,
            view.free,
            view.clearance,
            yaws=config.yaws,
            leaf_level=1,
            width=config.width,
            count=config.max_candidates,
            separation=SEPARATION_M,
            separation_deg=SEPARATION_DEG,
            **_circle(near, origin),
        )
        if not len(poses):
            return
        heights = self._ground.below(poses[:, :2]) - view.below
        total = int(np.unpackbits(slices).sum())
        for (x, y, yaw), z, score in zip(poses, heights, scores, strict=True):
            fit = max(0.0, float(score) / total)
            yield x + origin[0], y + origin[1], z + origin[2], yaw, fit


def _circle(near: Prior | None, origin: Float64) -> dict[str, float]:
    """Where poses are looked for, seen from above and from the origin."""
    if near is None:
        return {}
    x, y = np.asarray(near.position)[:2] - origin[:2]
    return {"x": float(x), "y": float(y), "radius": near.radius_m}


def _along(path: Float64, width: float, reach: float) -> NDArray[np.int32]:
    """Windows of that width within reach of a path of (V, 2) places."""
    steps = int(np.ceil(reach / width))
    around = np.mgrid[-steps : steps + 1, -steps : steps + 1].reshape(2, -1).T
    stations = np.unique(cells_of(path, width), axis=0)
    windows = np.unique((stations[:, None] + around).reshape(-1, 2), axis=0)
    gap, _ = nearest_of(path, (windows + 0.5) * width)
    return _int32(windows[gap < reach + 0.71 * width])


def _under(cloud: Float32, width: float) -> NDArray[np.int32]:
    """Windows of that width that any point lies in."""
    return _int32(np.unique(cells_of(cloud[:, :2], width), axis=0))


def _int32(cells: Int64) -> NDArray[np.int32]:
    return np.ascontiguousarray(cells, dtype=np.int32)
