"""The whole work that ``segloc bench`` times: scans, queries, building, aligning and streams."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from segloc import Config, MemoryRecording, Recording, Scan, SegmentMap, build_map, geometry
from segloc.frontend import LocalCloudConfig, window
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.tools.io import read_scan
from segloc.types import Float64, Int64

from .. import kitti00
from ..padding import padded_with_copies
from ..simulation import SENSORS, Route, SimulatedSequence, simulate_session, town

MAP_SEGMENTS, MILLION = 50_000, 1_000_000
FAR_M = 60.0
"""Distance from the mapped path beyond which a query sees nothing of the map."""
SCANS, QUERIES = 4, 12
"""Scans of each sensor, and queries in the map; as many are of other places."""
BUILT = 60
"""Scans of a map."""

TOWN_M, STREET_M, STREAM_M, ALIGNED_M = 250.0, 150.0, 82.0, 100.0
TILES = {"few tiles": 250.0, "many tiles": 100.0}
PRIOR_M, PRIOR_FAR_M = 50.0, 80.0
"""Radius of a prior, and least distance of a wrong one's circle from the truth."""
ASIDE_M = 10.0
"""Distance of the first query from the beginning of a street."""


@dataclass(frozen=True)
class Input:
    """Recordings that are processed at once.

    Attributes
    ----------
    recordings : sequence of Recording
        A query is one recording, of one scan without a pose or of several with poses.
    truths : (N, 4, 4) float64 or None
        True T_map_sensor of the scans; None for a query of another place.
    near : (x, y, radius) or None
        Prior of a query [m].
    """

    recordings: Sequence[Recording]
    truths: Float64 | None = None
    near: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Work:
    """Inputs of one kind of work, which are timed one after another.

    Attributes
    ----------
    title : str
    kind : str
        A method of ``worker.Work``.
    inputs : sequence of Input
    prior_map : SegmentMap or None
    tile_m : float or None
        Edge of the tiles that each version cuts the map into; None for one piece.
    """

    title: str
    kind: str
    inputs: Sequence[Input]
    prior_map: SegmentMap | None = None
    tile_m: float | None = None


def stages(data: Path | None) -> Iterator[Work]:
    """Process scans of each sensor up to their descriptors."""
    for title, scans in sensors(data):
        yield Work(title, "stages", [Input([MemoryRecording([scan])]) for scan in scans])


def query(data: Path | None) -> Iterator[Work]:
    """Localize single full scans in 50 000 segments."""
    yield in_map("query", single(data), MAP_SEGMENTS)


def million(data: Path | None) -> Iterator[Work]:
    """Localize the same scans in a million segments."""
    yield in_map("query", single(data), MILLION)


def tiles(data: Path | None) -> Iterator[Work]:
    """Localize single thinned scans in a map of a drive: in one piece, in few tiles and in many."""
    prior_map, queries = thinned(data)
    near = near_a_prior(queries, prior_map)
    for name, tile_m in {"one piece": None, **TILES}.items():
        yield Work(f"query in {name}", "query", queries, prior_map, tile_m)
        yield Work(f"query near a prior in {name}", "query", near, prior_map, tile_m)


def accumulated(data: Path | None) -> Iterator[Work]:
    """Localize the gathered scans of 40 m."""
    yield in_map("query of 40 m", gathered(data), MAP_SEGMENTS)


def os1_128(_: Path | None) -> Iterator[Work]:
    """Localize single simulated scans of an OS1-128."""
    yield in_map("query, OS1-128", simulated("os1-128", 1024), MAP_SEGMENTS)


def build(data: Path | None) -> Iterator[Work]:
    """Build a map."""
    kitti = kitti_of(data)
    mapped: Recording = drive("hdl64e", 1875) if kitti is None else kitti00.mapped(kitti, "single")
    yield Work("building", "build", [Input([part(mapped, range(min(BUILT, len(mapped))))])])


def align(_: Path | None) -> Iterator[Work]:
    """Align two simulated sessions with drifting odometry."""
    drives = (drive("hdl64e", 900, session=session, length_m=ALIGNED_M) for session in (0, 1))
    yield Work("aligning 2 sessions", "align", [Input([each.with_odometry() for each in drives])])


def stream(_: Path | None) -> Iterator[Work]:
    """Follow a stream of an HDL-64E, with a query at every tenth scan."""
    yield followed("hdl64e", 1875)


def stream_os1_128(_: Path | None) -> Iterator[Work]:
    """Follow a stream of an OS1-128."""
    yield followed("os1-128", 1024)


def stream_vlp16(_: Path | None) -> Iterator[Work]:
    """Follow a stream of a VLP-16."""
    yield followed("vlp16", 1800)


Place = tuple[SegmentMap, list[Input]]
"""A map, and queries in it and of other places."""


def in_map(title: str, place: Place, segments: int) -> Work:
    """Return the queries of a place in its map, padded to a number of segments."""
    prior_map, queries = place
    padded = padded_with_copies(prior_map, segments)
    return Work(f"{title}, {len(padded)} segments", "query", queries, padded)


def followed(sensor: str, firings: int) -> Work:
    """Return a later drive along a mapped street, a scan every metre."""
    later = drive(sensor, firings, session=1, length_m=STREAM_M, spacing_m=1.0)
    prior_map = padded_with_copies(simulated_map(), MAP_SEGMENTS)
    driven = Input([later.with_odometry()], later.truth)
    return Work(f"stream, {sensor}", "stream", [driven], prior_map)


# --- recordings -----------------------------------------------------------------------------------


def kitti_of(data: Path | None) -> Path | None:
    """Return the folder of KITTI 00, or None if there is none."""
    folder = None if data is None else data / "kitti00"
    return folder if folder is not None and folder.is_dir() else None


@cache
def single(data: Path | None) -> Place:
    """Map KITTI 00 or a simulated street; queries are full scans of an earlier or later drive."""
    kitti = kitti_of(data)
    return simulated("hdl64e", 1875) if kitti is None else real(kitti, "single", QUERIES)


def gathered(data: Path | None) -> Place:
    """Map KITTI 00 or a simulated street; queries are the scans of 40 m."""
    kitti = kitti_of(data)
    if kitti is None:
        return simulated("hdl64e", 900, length_m=LocalCloudConfig().window_m)
    return real(kitti, "accumulated", QUERIES // 2)


@cache
def thinned(data: Path | None) -> Place:
    """Map the first half of KITTI 00 or a simulated street; queries are scans of later passes."""
    kitti = kitti_of(data)
    return simulated("hdl64e", 900) if kitti is None else real(kitti, "sparse", QUERIES)


def near_a_prior(queries: Sequence[Input], prior_map: SegmentMap) -> list[Input]:
    """Return the queries within a map near a right prior, and near one at another place of it."""
    rng, path, found = np.random.default_rng(0), prior_map.trajectory[:, :2, 3], list[Input]()
    for query in queries:
        if query.truths is not None:
            x, y = query.truths[-1][:2, 3]
            aside = rng.uniform(-0.5, 0.5, 2) * PRIOR_M
            found.append(replace(query, near=(x + aside[0], y + aside[1], PRIOR_M)))
            far = path[np.hypot(*(path - (x, y)).T) > PRIOR_M + PRIOR_FAR_M]
            if len(far):
                x, y = far[rng.integers(len(far))]
                found.append(replace(query, truths=None, near=(float(x), float(y), PRIOR_M)))
    return found


def real(folder: Path, protocol: str, count: int) -> Place:
    """Return a map of KITTI 00 and queries of a protocol, in the map and far from it."""
    mapped, found = kitti00.mapped(folder, protocol), kitti00.query_set(folder, protocol)
    assert found.truths is not None
    length_m = LocalCloudConfig().window_m if kitti00.PROTOCOLS[protocol].accumulated else 0.0
    gaps = distances_to_path(found.truths, kitti00.poses_of(mapped))
    queries = []
    for chosen, inside in ((gaps <= COVERAGE_RADIUS_M, True), (gaps > FAR_M, False)):
        for k in spread(np.flatnonzero(chosen), count):
            scans = behind(found.recording, int(found.positions[k]), length_m)
            queries.append(Input([scans], found.truths[k, None] if inside else None))
    return built(mapped), queries


def simulated(sensor: str, firings: int, *, length_m: float = 0.0) -> Place:
    """Return the map of a simulated street and queries of later drives, there and elsewhere."""
    queries = []
    for seed in (0, 1):
        later = drive(sensor, firings, session=1, seed=seed).with_odometry()
        enough = np.flatnonzero(geometry.distance_travelled(later.truth) >= max(length_m, ASIDE_M))
        for i in spread(enough, SCANS).tolist():
            scans = behind(later, i, length_m)
            queries.append(Input([scans], later.truth[i, None] if seed == 0 else None))
    return simulated_map(), queries


@cache
def simulated_map() -> SegmentMap:
    """Map a street of a simulated town."""
    return built(drive("hdl64e", 900))


def built(recording: Recording) -> SegmentMap:
    """Build a map on one thread."""
    return build_map(recording, Config(threads=1))


@cache
def drive(
    sensor: str,
    firings: int,
    *,
    session: int = 0,
    seed: int = 0,
    length_m: float = STREET_M,
    spacing_m: float = 2.0,
) -> SimulatedSequence:
    """Drive along a street of a simulated town, later sessions on another lane."""
    world = town(seed, size_m=TOWN_M)
    ways = world.roads.walk(np.random.default_rng(0), [0], STREET_M, avoid=[])
    route = Route(tuple(ways), 0.3 if session else 1.1, spacing_m, length_m)
    return simulate_session(world, session, route, SENSORS[sensor](firings), session)


def behind(recording: Recording, i: int, length_m: float) -> Recording:
    """Return the scans of a path that ends at one; that scan without a pose if it is alone."""
    if not length_m:
        scan = recording.scan(i)
        return MemoryRecording([Scan(scan.points)])
    poses, gap_m = kitti00.poses_of(recording), LocalCloudConfig().max_gap_m
    return part(recording, window(poses, i, length_m, centred=False, max_gap_m=gap_m))


def part(recording: Recording, positions: Sequence[int]) -> Recording:
    """Return some scans of a recording, with their poses."""
    poses = kitti00.poses_of(recording)[list(positions)]
    return MemoryRecording([recording.scan(i) for i in positions], poses)


def spread(positions: Int64, count: int) -> Int64:
    """Return at most a number of the positions, evenly spread."""
    which = np.linspace(0, len(positions) - 1, min(count, len(positions)))
    return positions[which.astype(np.int64)].astype(np.int64)


SIMULATED = {
    "HDL-64E": ("hdl64e", 1875),
    "OS1-128": ("os1-128", 1024),
    "VLP-16": ("vlp16", 1800),
    "MID-360": ("mid360", 20_000),
}
REAL = {
    "HDL-64E": "kitti00/scans",
    "VLP-16": "vlp16_corridor/scans",
    "MID-360": "mid360_lab/0618/scans",
}
"""Scans of a sensor in the folder of recordings; those of the MID-360 are crops of a map."""


def sensors(data: Path | None) -> Iterator[tuple[str, list[Scan]]]:
    """Return a few scans of each sensor, real ones if there are any."""
    for name, sensor in SIMULATED.items():
        files = sorted((data / REAL[name]).glob("*.laz")) if data and name in REAL else []
        if files:
            chosen = spread(np.arange(len(files)), SCANS)
            yield f"{name}, {REAL[name]}", [Scan(read_scan(files[i]).points) for i in chosen]
        else:
            driven = drive(*sensor)
            chosen = spread(np.arange(len(driven)), SCANS)
            yield f"{name}, simulated", [Scan(driven.scan(int(i)).points) for i in chosen]
