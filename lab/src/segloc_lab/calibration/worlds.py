"""Generate simulated worlds: maps and queries on which the posterior is fitted and evaluated.

One sensor maps each world in one session; several sensors return in another, in which a fifth of
the objects have been replaced. Outdoors they ride on a car, in autumn; in warehouses and offices a
hand carries them and tilts up to 35 degrees. The poses of every second world err by centimetres, as
those of real maps do, so that its walls are less sharp.

Each world becomes a folder ``KIND-SEED`` with ``own.segmap``, ``half.segmap`` (the first half of
the mapped route) and ``queries.npz`` (:class:`QuerySet`). Folders that exist are kept.

    python -m segloc_lab.calibration.worlds --first-seed 21000 --each 12 --out rows/fit --workers 2
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import count
from pathlib import Path
from shutil import rmtree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from segloc import Config, Scan, build_map
from segloc.frontend import LocalCloudConfig, window
from segloc.tools.batch import query_positions
from segloc.tools.datasets import Selection, Sequence
from segloc.types import Float32, Float64, Int64, Pose

from ..parallel import in_parallel
from ..script import parser
from ..simulation import (
    SCENES,
    SENSORS,
    Conditions,
    Platform,
    SimulatedSequence,
    handheld,
    simulate_sessions,
)
from ..simulation.bare_views import VIEWS, view

LENGTH_M = 90.0
"""Length of each drive [m]."""
EVERY_M = 10.0
"""Spacing of single queries along a drive [m]; accumulated ones are made at every second."""
AZIMUTHS = 900
"""Firings of each beam in a turn."""
MAX_THINNED = 6_400
"""Points of a thinned scan."""
NARROW_DEG, SHORT_M = (20.0, 90.0), (5.0, 10.0, 20.0, 40.0)
"""Fields of view and ranges of narrow views [deg, m]."""
BARE_VIEWS = 10
"""Made views of each kind in a world."""
SCANS_IN_MEMORY = 64
LATER = Conditions(foliage=0.6, replaced=0.2)
UNSHARP_M, UNSHARP_DEG = 0.04, 0.15
"""Standard deviation of pose errors in every second world [m, deg], each axis."""
SEALED = Path(__file__).with_name("sealed-seeds.txt")
"""Seeds of the worlds that judge the fit and take no part in it."""


@dataclass(frozen=True)
class Kind:
    """A kind of world: its size, the sensor that maps it, and the sensors that return.

    Parts of a world that is ``alike`` can be exact copies of each other: its mirror image, or what
    lies past the end of its map, may equal what the map holds.
    """

    size_m: float
    alike: bool = False
    mapped_by: str = "hdl64e"
    sensors: tuple[str, ...] = ("hdl64e", "vlp16")
    platform: Platform | None = None


INDOORS = Kind(80.0, False, "os1-64", ("os1-64", "vlp16"), handheld())
KINDS = {
    "town": Kind(200.0),
    "warehouse": replace(INDOORS, alike=True),
    "industrial": Kind(200.0),
    "park": Kind(200.0),
    "offices": INDOORS,
    "meadow": Kind(200.0),
    "forest": Kind(150.0),
}


@dataclass(frozen=True)
class SimulatedWorld:
    """A session to map, and later sessions of several sensors to localize."""

    name: str
    mapped: SimulatedSequence
    queries: dict[str, SimulatedSequence]


def seeds(first_seed: int, each: int) -> Iterator[tuple[str, int]]:
    """Yield kinds in turn with the seeds of their worlds."""
    yield from zip(list(KINDS) * each, count(first_seed), strict=False)


def simulated(name: str, seed: int, length_m: float = LENGTH_M) -> SimulatedWorld:
    """Make a world and the drives through it; scans are cast when they are read."""
    kind = KINDS[name]
    world = SCENES[name](seed, size_m=kind.size_m)
    drive = partial(simulate_sessions, world, length_m=length_m, seed=seed)
    mapped = drive(SENSORS[kind.mapped_by](AZIMUTHS), [Conditions()])[0]
    queries = {
        sensor: drive(SENSORS[sensor](AZIMUTHS), [Conditions(), LATER], platform=kind.platform)[1]
        for sensor in kind.sensors
    }
    if seed % 2:
        mapped = unsharp(mapped, seed)
        queries = {sensor: unsharp(each, seed) for sensor, each in queries.items()}
    return SimulatedWorld(f"{name} {seed}", mapped, queries)


def unsharp(drive: SimulatedSequence, seed: int) -> SimulatedSequence:
    """Add an error to each pose of a drive: that of its number, the same in all of one seed."""
    rng = np.random.default_rng([seed, 7])
    off = np.stack([np.eye(4)] * len(drive))
    off[:, :3, 3] = rng.normal(0.0, UNSHARP_M, (len(drive), 3))
    turns = rng.normal(0.0, np.radians(UNSHARP_DEG), (len(drive), 3))
    off[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    return replace(drive, poses=drive.poses @ off)


def thinned(points: Float32, seed: int) -> Float32:
    """Thin a scan to ``MAX_THINNED`` points, as slow links and small memories do."""
    if len(points) <= MAX_THINNED:
        return points
    kept = np.random.default_rng(seed).choice(len(points), MAX_THINNED, replace=False)
    return points[kept]


def narrowed(points: Float32, seed: int) -> Float32:
    """Return what a sensor of a narrow field of view and a short range sees of a scan."""
    rng = np.random.default_rng([seed, len(points)])
    middle, width = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*NARROW_DEG))
    off = np.arctan2(points[:, 1], points[:, 0]) - middle
    aside = np.abs((off + np.pi) % (2.0 * np.pi) - np.pi)
    near = np.linalg.norm(points, axis=1) < rng.choice(SHORT_M)
    seen: Float32 = points[near & (aside < width / 2.0)]
    return seen


def bare(seed: int) -> Iterator[Made]:
    """Yield made views that fix no place."""
    for name in VIEWS:
        for n in range(BARE_VIEWS):
            yield Made("", "bare", [Scan(view(name, 1000 * seed + n))], None)


def first_half(drive: SimulatedSequence) -> SimulatedSequence:
    """Return the first half of a drive's scans."""
    last = drive.indices[len(drive) // 2 - 1]
    return drive.select(Selection(((0, int(last)),)))


def views(
    drive: Sequence, every_m: float, local: LocalCloudConfig
) -> Iterator[tuple[int, list[Scan], Scan]]:
    """Yield queries along a drive: the scan's position, the window that it ends, and the scan."""
    poses, scan = drive.poses, lru_cache(SCANS_IN_MEMORY)(drive.scan)  # windows overlap
    assert poses is not None
    for i in query_positions(poses, every_m, local.max_gap_m):
        behind = window(poses, i, local.window_m, centred=False, max_gap_m=local.max_gap_m)
        yield int(i), [scan(k) for k in behind], scan(i)


@dataclass(frozen=True)
class Made:
    """A query as a localizer is given it.

    Attributes
    ----------
    scans : list of Scan
        One scan without a pose, or consecutive ones with odometry poses.
    truth : (4, 4) float64 or None
        T_map_sensor of the last scan; None of a view of no place.
    """

    sensor: str
    kind: str
    scans: list[Scan]
    truth: Pose | None


@dataclass(frozen=True)
class QuerySet:
    """The queries of one drive, made again without simulating: scans are stored once.

    Attributes
    ----------
    points : (N, 3) float32
        All scans in their sensor frames, one after another.
    offsets : (S + 1,) int64
        The rows of ``points`` at which scans begin.
    poses, truth : (S, 4, 4) float64
        T_odom_sensor and T_map_sensor of each scan.
    spans : (Q, 2) int64
        The first scan of each query and its last; single ones begin where they end.
    thinning : (Q,) int64
        Seed by which a single scan is thinned; -1 where it is not.
    """

    sensor: str
    points: Float32
    offsets: Int64
    poses: Float64
    truth: Float64
    spans: Int64
    thinning: Int64

    @classmethod
    def of(cls, sensor: str, drive: SimulatedSequence, local: LocalCloudConfig) -> QuerySet:
        """Cast the scans of a drive's queries."""
        spans, thinning = _planned(drive.poses, local)
        last = int(spans.max()) + 1 if len(spans) else 0
        used = np.zeros(last, bool)
        for first, end in spans:
            used[first : end + 1] = True
        empty = np.empty((0, 3), np.float32)
        scans = [drive.scan(i).points if used[i] else empty for i in range(last)]
        offsets = np.concatenate([[0], np.cumsum([len(points) for points in scans])])
        points = np.concatenate(scans) if scans else empty
        kept = drive.poses[:last], drive.truth[:last]
        return cls(sensor, points, offsets.astype(np.int64), *kept, spans, thinning)

    def __len__(self) -> int:
        return len(self.spans)

    def __iter__(self) -> Iterator[Made]:
        for (first, last), seed in zip(self.spans, self.thinning, strict=True):
            truth = self.truth[last]
            if first < last:
                yield Made(self.sensor, "accumulated", self.scans(first, last + 1), truth)
            elif seed < 0:
                yield Made(self.sensor, "single", [Scan(self._scan(last))], truth)
            else:
                points = thinned(self._scan(last), int(seed))
                yield Made(self.sensor, "thinned", [Scan(points)], truth)

    def narrow(self) -> Iterator[Made]:
        """Yield narrow views of the scans that are thinned."""
        for (_, last), seed in zip(self.spans, self.thinning, strict=True):
            if seed >= 0:
                points = narrowed(self._scan(last), int(seed))
                yield Made(self.sensor, "narrow", [Scan(points)], self.truth[last])

    def scans(self, first: int = 0, end: int | None = None) -> list[Scan]:
        """Return scans with odometry poses, by default all."""
        numbers = range(len(self.poses))[first:end]
        return [Scan(self._scan(i), T_odom_sensor=self.poses[i]) for i in numbers]

    def _scan(self, i: int) -> Float32:
        return self.points[self.offsets[i] : self.offsets[i + 1]]


def _planned(poses: Float64, local: LocalCloudConfig) -> tuple[Int64, Int64]:
    """Plan the queries along a drive: spans of scans, and seeds of thinning."""
    spans, thinning = [], []
    for n, i in enumerate(query_positions(poses, EVERY_M, local.max_gap_m)):
        spans.append((i, i))
        thinning.append(n if n % 2 else -1)
        if n % 2:
            behind = window(poses, i, local.window_m, centred=False, max_gap_m=local.max_gap_m)
            spans.append((behind[0], behind[-1]))
            thinning.append(-1)
    return np.array(spans, np.int64).reshape(-1, 2), np.array(thinning, np.int64)


_ARRAYS = ("points", "offsets", "poses", "truth", "spans", "thinning")


def save_queries(path: Path, sets: list[QuerySet]) -> None:
    """Write the queries of all drives through a world."""
    arrays: dict[str, NDArray[np.generic]] = {
        f"{each.sensor}/{name}": getattr(each, name) for each in sets for name in _ARRAYS
    }
    np.savez(path, **arrays)  # type: ignore[arg-type]


def load_queries(path: Path) -> list[QuerySet]:
    """Read what :func:`save_queries` wrote."""
    with np.load(path) as file:
        sensors = dict.fromkeys(name.split("/")[0] for name in file.files)
        return [QuerySet(s, *(file[f"{s}/{name}"] for name in _ARRAYS)) for s in sensors]


def write_world(world: SimulatedWorld, folder: Path, config: Config) -> None:
    """Build and write a world's maps and queries; the folder appears when it is complete."""
    part = folder.with_name(f"{folder.name}.part")
    rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    build_map(world.mapped, config).save(part / "own.segmap")
    build_map(first_half(world.mapped), config).save(part / "half.segmap")
    local = config.local_cloud
    sets = [QuerySet.of(sensor, drive, local) for sensor, drive in world.queries.items()]
    save_queries(part / "queries.npz", sets)
    part.rename(folder)


def generated(folder: Path) -> list[Path]:
    """List the folders of complete worlds, by seed."""
    found = [p for p in folder.iterdir() if (p / "queries.npz").exists() and p.suffix != ".part"]
    return sorted(found, key=seed_of)


def kind_of(world: Path | str) -> str:
    """Return the kind of a world, of :data:`KINDS`, by the name of its folder."""
    return Path(world).name.rsplit("-", 1)[0]


def seed_of(world: Path) -> int:
    """Return the seed of a world by the name of its folder."""
    return int(world.name.rsplit("-", 1)[1])


def generate(folder: Path) -> float:
    """Make the world of a folder ``KIND-SEED``; return the processor time [s]."""
    config = Config(threads=1)
    start = time.process_time()
    write_world(simulated(kind_of(folder), seed_of(folder)), folder, config)
    return time.process_time() - start


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--each", type=int, default=2, help="worlds of every kind")
    options.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    options.add_argument("--first-seed", type=int, default=21000)
    options.add_argument("--out", type=Path, default=Path("rows"))
    options.add_argument("--workers", type=int, default=1, help="processes")
    args = options.parse_args()
    named = seeds(args.first_seed, args.each)
    folders = [args.out / f"{name}-{seed}" for name, seed in named if name in args.kinds]
    left = [folder for folder in folders if not folder.exists()]
    for number, seconds in in_parallel(generate, left, args.workers):
        print(f"{left[number].name}: {seconds:.1f} s", flush=True)


if __name__ == "__main__":
    main()
