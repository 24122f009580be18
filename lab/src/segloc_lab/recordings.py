"""Recordings made of others: without poses, with fewer beams, kept on disk, from beside."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from segloc import geometry
from segloc.system.files import replacing
from segloc.tools.io import read_scan
from segloc.types import Derived, Float64, Int64, Pose, Recording, Scan, stamp_at

from .kitti00 import poses_of
from .simulation import SimulatedSequence
from .simulation.motion.platforms import on_ground

LOWEST_DEG, HIGHEST_DEG, BEAMS = -24.9, 2.0, 64
"""Elevations of an HDL-64E."""

ROOM_M = 1.5
"""Around a sensor, free of anything."""

_MIN_POINTS = 1000


class Unposed(Derived[Recording]):
    """Scans without poses: each is a query by itself.

    The attitude of the sensor stays known if the source contains it.
    """

    poses = None


@dataclass(frozen=True)
class FewerBeams(Derived[Recording]):
    """Scans of an HDL-64E with every N-th beam kept, without poses.

    A beam is a band of elevation, 26.9 degrees divided by 64.
    """

    keep_every: int

    poses = None

    @property
    def name(self) -> str:
        return f"{self.source.name}, {BEAMS // self.keep_every} beams"

    def scan(self, i: int) -> Scan:
        """The scan at position i, thinned."""
        points = super().scan(i).points
        elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
        beam = np.floor((elevation - LOWEST_DEG) / (HIGHEST_DEG - LOWEST_DEG) * BEAMS)
        return Scan(points[beam % self.keep_every == 0], stamp=stamp_at(self, i))


class Surveyed(Derived[SimulatedSequence]):
    """A simulated drive whose clouds are gathered by odometry, and placed by the truth."""

    @property
    def poses(self) -> Float64:
        return self.source.truth

    def object_ids(self, i: int) -> NDArray[np.int32]:
        """The true object of every point of a scan."""
        return self.source.object_ids(i)


class Cached:
    """A recording that keeps its scans in memory, or the last ``most`` of them."""

    def __init__(self, recording: Recording, most: int | None = None) -> None:
        self.name, self.indices, self.poses = recording.name, recording.indices, recording.poses
        self.stamps = recording.stamps
        self.scan = lru_cache(most)(recording.scan)

    def __len__(self) -> int:
        return len(self.indices)


@dataclass(frozen=True)
class Kept(Derived[SimulatedSequence]):
    """A simulated drive whose scans are cast once, and kept in a folder; None: never kept."""

    folder: Path | None

    @property
    def truth(self) -> Float64:
        return self.source.truth

    @property
    def poses(self) -> Float64:
        return self.source.poses

    def with_odometry(self) -> Kept:
        """The same scans with poses as odometry would give them."""
        return replace(self, source=self.source.with_odometry())

    def scan(self, i: int) -> Scan:
        """The scan at position i."""
        if self.folder is None:
            return super().scan(i)
        path = self.folder / f"{i}.npy"
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as stream:  # several runs may share the folder
                np.save(stream, super().scan(i).points)
        return Scan(np.load(path), stamp=stamp_at(self, i), T_odom_sensor=self.poses[i])


def kept(drive: SimulatedSequence, root: Path | None) -> Kept:
    """The drive, its scans in a folder of its own below ``root``."""
    if root is None:
        return Kept(drive, None)
    world = drive.world
    made_of = world.recipe[1] if world.recipe else ()
    key = repr((world.name, made_of, drive.session, drive.seed, drive.sensor, drive.conditions))
    digest = hashlib.sha256(key.encode() + drive.truth.tobytes()).hexdigest()[:12]
    return Kept(drive, root / f"{world.name}-{drive.name.replace(' ', '-')}-{digest}")


def beside(
    drive: SimulatedSequence, path: Float64, offset_m: float, turned: bool = False
) -> SimulatedSequence:
    """The session seen from an offset to the left of a path, optionally turned about."""
    shift = geometry.yaw_transform(np.pi if turned else 0.0, (0.0, offset_m, 0.0))
    moved = np.stack([T @ shift for T in path])
    yaw = np.array([geometry.heading(T) for T in moved])
    poses = on_ground(drive.world.terrain, moved[:, :2, 3], yaw, drive.sensor.mount_height_m)
    indices = np.arange(len(poses), dtype=np.int64)
    return replace(drive, indices=indices, truth=poses, poses=poses, _last=None)


def has_room(scan: Scan, mount_height_m: float) -> bool:
    """Whether nothing stands where the sensor does."""
    x, y, z = scan.points.T
    near = (x**2 + y**2 < ROOM_M**2) & (z > 0.4 - mount_height_m)
    return len(scan) > _MIN_POINTS and not near.any()


@dataclass(frozen=True)
class Turned(Derived[Recording]):
    """Scans of a sensor that is not level, without poses: each is rolled and pitched at random.

    The angles are drawn evenly up to ``most_deg``, by ``seed`` and the position of the scan.
    """

    most_deg: float
    seed: int = 0

    poses = None

    @property
    def name(self) -> str:
        return f"{self.source.name}, turned by up to {self.most_deg:g} degrees"

    def T_turned_level(self, i: int) -> Pose:
        """How the scan at position i is turned."""
        rng = np.random.default_rng((self.seed, i))
        roll, pitch = rng.uniform(-self.most_deg, self.most_deg, 2)
        rotation = Rotation.from_euler("xy", (roll, pitch), degrees=True)
        return geometry.rigid(rotation.as_matrix(), np.zeros(3))

    def scan(self, i: int) -> Scan:
        """The scan at position i, turned."""
        T = self.T_turned_level(i)
        return Scan(geometry.transform(T, super().scan(i).points), stamp=stamp_at(self, i))


def posed(recording: Recording) -> Iterator[Float64]:
    """Yield the points of each scan in the frame of the recording's poses, (N, 3)."""
    for i, T in enumerate(poses_of(recording)):
        yield geometry.transform(T, recording.scan(i).points)


def with_poses(recording: Recording) -> Iterator[Scan]:
    """Yield each scan with its pose, as one without the others."""
    for i, T in enumerate(poses_of(recording)):
        yield Scan(recording.scan(i).points, T_odom_sensor=T)


def one_a_voxel(points: Float64, metres: float) -> Float64:
    """Return one point of a cloud, (N, 3), in each voxel."""
    first: Int64 = np.unique(np.floor(points / metres), axis=0, return_index=True)[1]
    return points.take(first, axis=0)


class Files:
    """Scans in files that belong to no drive, in the order of their names, without poses."""

    stamps = None
    poses = None

    def __init__(self, folder: Path) -> None:
        self.name = folder.name
        self._paths = sorted(path for path in folder.iterdir() if path.is_file())
        self.indices = np.arange(len(self._paths), dtype=np.int64)

    def __len__(self) -> int:
        return len(self._paths)

    def scan(self, i: int) -> Scan:
        """The scan at position i."""
        return read_scan(self._paths[i])
