"""A plan of a building -> a map: scans are cast in it along a way, and built like a recording."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .. import _native, geometry
from ..errors import DatasetError
from ..system.checks import MAX_LOCAL_METRES
from ..types import Float32, Float64, Int64, Pose, Scan
from .build import build_merged_map
from .config import BuildConfig, checked_build_config
from .info import PLAN, SOURCE, TOLERANCE
from .plan_tour import free_floors, storeys
from .segment_map import SegmentMap

Progress = Callable[[int, int], None]
Note = Callable[[str], None]

SENSOR_HEIGHT_M, TOLERANCE_M = 1.0, 0.05
_AZIMUTHS, _ELEVATIONS_DEG = 720, np.arange(-60.0, 60.1, 1.5)
_NOISE_M = 0.01
_VOXEL_M = 0.3


class PlanDrive:
    """Scans that are cast in a plan on access.

    Parameters
    ----------
    mesh : MeshRays
    way : (V, 3) float64
        Viewpoints in the frame of the mesh.
    origin : (3,) float64
        Of that frame, in the map.
    reach_m : float
        Longest range.
    name : str
    threads : int
    """

    stamps = None

    def __init__(
        self,
        mesh: _native.MeshRays,
        way: Float64,
        origin: Float64,
        reach_m: float,
        name: str,
        threads: int,
    ) -> None:
        self.name = name
        self._mesh, self._way, self._reach_m, self._threads = mesh, way, reach_m, threads
        self.indices: Int64 = np.arange(len(way), dtype=np.int64)
        self.poses: Float64 = np.array([geometry.rigid(np.eye(3), at + origin) for at in way])
        self._rays = _rays()

    def __len__(self) -> int:
        return len(self._way)

    def scan(self, i: int) -> Scan:
        """Return what is visible from viewpoint i."""
        origins = np.repeat(self._way[i : i + 1].astype(np.float32), len(self._rays), axis=0)
        ranges, hit = self._mesh.cast(origins, self._rays, self._reach_m, self._threads)
        met = hit >= 0
        noise = np.random.default_rng(i).normal(0.0, _NOISE_M, len(ranges))
        points = self._rays[met] * (ranges + noise)[met, None]
        return Scan(points.astype(np.float32), T_odom_sensor=self.poses[i])


def _rays() -> Float32:
    """Return the directions of a scan, (R, 3)."""
    turn = np.arange(_AZIMUTHS) * (2 * math.pi / _AZIMUTHS)
    up = np.radians(_ELEVATIONS_DEG)[:, None]
    rays = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)), -1)
    return np.ascontiguousarray(rays.reshape(-1, 3), dtype=np.float32)


def build_from_mesh(
    triangles: ArrayLike,
    config: BuildConfig | None = None,
    *,
    sensor_height: float = SENSOR_HEIGHT_M,
    tolerance: float = TOLERANCE_M,
    progress: Progress | None = None,
    note: Note | None = None,
) -> SegmentMap:
    config = checked_build_config(config)
    local, origin = _checked(triangles, note)
    mesh = _native.MeshRays(local)
    floors = free_floors(mesh, local, sensor_height)
    drives = [
        PlanDrive(
            mesh,
            np.concatenate([floor.way() for floor in storey]),
            origin,
            config.local_cloud.radius_m,
            f"storey {k}",
            config.threads,
        )
        for k, storey in enumerate(storeys(floors))
    ]
    built = build_merged_map(drives, config, views=progress)
    built.metadata |= {SOURCE: PLAN, TOLERANCE: f"{tolerance:g}"}
    return built


def _checked(triangles: ArrayLike, note: Note | None) -> tuple[Float32, Float64]:
    given = np.asarray(triangles, dtype=np.float64)
    origin = np.round(np.median(given.reshape(-1, 3), axis=0))
    return np.ascontiguousarray(given - origin, dtype=np.float32), origin
