"""A plan of a building -> a map: scans are cast in it along a way, and built like a recording.

Experimental. What a plan has not, such as furniture, is missing in the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .. import geometry
from ..errors import ConfigError, DatasetError, InvalidScan
from ..system.checks import MAX_LOCAL_METRES
from ..system.text import quantity
from ..types import Float32, Float64, Int64, Scan
from .build import build_merged_map
from .config import BuildConfig, checked_build_config
from .info import MAX_TOLERANCE_M, PLAN, SOURCE, TOLERANCE
from .plan_tour import Floor, PlanMesh, free_floors, storeys
from .segment_map import SegmentMap

Progress = Callable[[int, int], None]
Note = Callable[[str], None]

SENSOR_HEIGHT_M, TOLERANCE_M = 1.0, 0.05
"""Defaults: height of the viewpoints over the floor, and how far walls may be off the plan [m]."""
VOXEL_M = 0.1
"""Voxel of the cloud for verification [m]: thinner than walls, whose faces it keeps apart."""
_TALLEST_M = 1000.0
"""Height that no building has; a storey in millimetres has more."""
_AZIMUTHS, _ELEVATIONS_DEG = 600, np.arange(-60.0, 61.0, 2.0)
_NOISE_M = 0.01  # of ranges, as a sensor's: planes without any are degenerate


class PlanDrive:
    """Recording whose scans are cast in a plan on access.

    Parameters
    ----------
    mesh : PlanMesh
    way : (V, 3) float64
        Viewpoints in the frame of the mesh [m].
    origin : (3,) float64
        Of that frame in the map.
    reach_m : float
        Longest range.
    name : str
    """

    stamps = None

    def __init__(
        self, mesh: PlanMesh, way: Float64, origin: Float64, reach_m: float, name: str
    ) -> None:
        self.name = name
        self._mesh, self._way, self._reach_m, self._rays = mesh, way, reach_m, _rays()
        self.indices: Int64 = np.arange(len(way), dtype=np.int64)
        self.poses: Float64 = np.array([geometry.rigid(np.eye(3), at + origin) for at in way])

    def __len__(self) -> int:
        return len(self._way)

    def scan(self, i: int) -> Scan:
        """Return what is visible from viewpoint i."""
        ranges, hit = self._mesh.cast(self._way[[i]], self._rays, self._reach_m)
        ranges += np.random.default_rng(i).normal(0.0, _NOISE_M, len(ranges)).astype(np.float32)
        met = hit >= 0
        return Scan(self._rays[met] * ranges[met, None], T_odom_sensor=self.poses[i])


def _rays() -> Float32:
    """Return the directions of a scan, (R, 3)."""
    turn = np.arange(_AZIMUTHS) * (2 * math.pi / _AZIMUTHS)
    up = np.radians(_ELEVATIONS_DEG)[:, None]
    axes = np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)
    rays = np.stack(np.broadcast_arrays(*axes), axis=-1).reshape(-1, 3)
    return np.ascontiguousarray(rays, dtype=np.float32)


def build_from_mesh(
    triangles: ArrayLike,
    config: BuildConfig | None = None,
    *,
    sensor_height: float = SENSOR_HEIGHT_M,
    tolerance: float = TOLERANCE_M,
    progress: Progress | None = None,
    note: Note | None = None,
) -> SegmentMap:
    """Build a map from the plan of a building. Experimental.

    Scans are cast from a way through all rooms and corridors, storey by storey, and mapped like a
    recording. Both sides of a triangle are seen, and both faces of a wall are kept apart.

    Parameters
    ----------
    triangles : (T, 3, 3) array
        Corners in the map's frame [m], z up; :func:`segloc.tools.io.meshes.read_plan` reads them.
        Triangles with corners that are not finite are left out.
    config : BuildConfig, optional
        Or a :class:`segloc.Config`, which is one; by default that of the default method. The voxel
        of its cloud is at most ``VOXEL_M``.
    sensor_height : float
        Height of the viewpoints over the floor [m].
    tolerance : float
        How far the building may be off its plan [m]; kept in the map.
    progress : callable, optional
        Called with (views done, total) of each storey.
    note : callable, optional
        Called with each remark, one line.

    Raises
    ------
    DatasetError
        If there are no triangles, they are more than 100 km apart or 1 km high, or no floor has
        room for a sensor.
    InvalidScan
        If ``triangles`` are something else.
    ConfigError
        If ``config`` is none, or a length is out of range.
    """
    config = _finer(checked_build_config(config))
    for metres, name, most in (
        (sensor_height, "sensor_height", 10.0),
        (tolerance, "tolerance", MAX_TOLERANCE_M),
    ):
        if not 0 < metres <= most:
            raise ConfigError(f"{name} must be in 0..{most:g} m, not {metres}")
    tell = note or (lambda _: None)
    local, origin = _check(triangles, tell)
    mesh = PlanMesh.of(local, config.threads)
    floors = free_floors(mesh, sensor_height)
    if not floors:
        raise DatasetError(
            f"no floor with {sensor_height:g} m of room above it and walls around it in "
            f"{quantity(len(local), 'triangles')}: is the unit right, and which axis points up?"
        )
    drives = [
        _drive(mesh, parts, origin, f"storey {k}", config)
        for k, parts in enumerate(storeys(floors))
    ]
    area, count = sum(floor.area_m2 for floor in floors), sum(map(len, drives))
    tell(
        f"{area:.0f} m2 of free floor in {quantity(len(drives), 'storeys')}; scans are cast from "
        f"{quantity(count, 'viewpoints')}"
    )
    built = build_merged_map(drives, config, views=progress)
    built.metadata |= {SOURCE: PLAN, TOLERANCE: f"{tolerance:g}"}
    return built


def _drive(
    mesh: PlanMesh, parts: list[Floor], origin: Float64, name: str, config: BuildConfig
) -> PlanDrive:
    """Return the drive through one storey."""
    way = np.concatenate([part.way() for part in parts])
    return PlanDrive(mesh, way, origin, config.local_cloud.radius_m, name)


def _finer(config: BuildConfig) -> BuildConfig:
    """Return the configuration with a voxel that keeps the faces of walls apart."""
    voxel = min(config.mapping.cloud_voxel, VOXEL_M)
    mapping = config.mapping.model_copy(update={"cloud_voxel": voxel})
    return config.model_copy(update={"mapping": mapping})


def _check(triangles: ArrayLike, tell: Note) -> tuple[Float32, Float64]:
    """Return the usable triangles about an origin, and that origin."""
    given = np.asarray(triangles)
    if given.ndim != 3 or given.shape[1:] != (3, 3) or given.dtype.kind != "f":
        raise InvalidScan(
            f"triangles must be (T, 3, 3) floating point, not {given.shape} {given.dtype}"
        )
    finite = np.isfinite(given).all(axis=(1, 2))
    if dropped := int((~finite).sum()):
        tell(f"{quantity(dropped, 'triangles')} left out: corners are not finite")
    usable = given[finite].astype(np.float64)
    if not len(usable):
        raise DatasetError("the plan has no triangles")
    origin = np.round(np.median(usable.reshape(-1, 3), axis=0))
    far = float(np.abs(usable - origin).max())
    if far > MAX_LOCAL_METRES:
        raise DatasetError(
            f"triangles lie up to {far / 1000:.0f} km apart, at most {MAX_LOCAL_METRES / 1000:g}: "
            "is the unit right?"
        )
    tall = float(np.ptp(usable[..., 2]))
    if tall > _TALLEST_M:
        raise DatasetError(
            f"the plan is {tall:.0f} m high, no building is: is the unit right, and which axis "
            "points up?"
        )
    return np.ascontiguousarray(usable - origin, dtype=np.float32), origin
