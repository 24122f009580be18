"""A city of simulated towns: each mapped at a place of its own, some driven a second time."""

from __future__ import annotations

import json
import math
import os
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from segloc import Config, SegmentMap, build_map, geometry
from segloc.loops import Reposed
from segloc.map import CompactConfig, compacted
from segloc.system.files import replacing
from segloc.tiles import INDEX, TiledMap, store_of, write_tile
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path, query_clouds, query_positions
from segloc.types import Descriptors, Float64, LocalCloud, Pose

from .simulation import SENSORS, Conditions, SimulatedSequence, simulate_sessions, town

A_ROW = 10
"""Towns side by side."""
PITCH_M = 30.0
"""Between a town and the next, and one that no multiple of the edge of a tile repeats."""
APART_M = 1000.0
SPREAD, SHIFT_M = 0.2, 0.2
"""Noise of descriptors, as a share of their spread, and of centroids."""
SPACING_M, EVERY_M, MAX_GAP_M, SQUARE_M = 2.0, 20.0, 10.0, 8.0


@dataclass(frozen=True)
class Piece:
    """A town to be mapped, and perhaps to be queried.

    Attributes
    ----------
    number : int
        Its place in the city; -1: it is not there.
    size_m, length_m : float
        Of the town's edge, and of the drive that maps it.
    thin : int
        Every n-th firing of an HDL-64E.
    queries : int
        Of another traversal.
    folder : Path
        For what is made.
    until : float
        Time of the day, s since 1970, after which nothing is begun.
    """

    number: int
    seed: int
    size_m: float
    length_m: float
    thin: int
    queries: int
    folder: Path
    until: float = float("inf")

    @property
    def record(self) -> Path:
        """Written last."""
        return self.folder / f"piece-{self.seed}.json"

    @property
    def map_file(self) -> Path:
        return self.folder / f"piece-{self.seed}.segmap"

    @property
    def T_city_town(self) -> Pose:
        pitch = self.size_m + PITCH_M
        j, i = divmod(max(self.number, 0), A_ROW)
        return geometry.rigid(np.eye(3), np.array([i * pitch, j * pitch, 0.0]))


def done(piece: Piece) -> bool:
    """Map a town and record what it cost, unless that was done or there is no time left."""
    if piece.record.exists():
        return True
    if time.time() > piece.until:
        return False
    piece.folder.mkdir(parents=True, exist_ok=True)
    began = time.time(), time.process_time()
    world = town(piece.seed, size_m=piece.size_m)
    drives = simulate_sessions(
        world,
        SENSORS["hdl64e"]().thinned(piece.thin),
        [Conditions(), Conditions()],
        length_m=piece.length_m,
        spacing_m=SPACING_M,
        seed=piece.seed,
    )
    first = _placed(drives[0], piece)
    first.scan(0)
    found: dict[str, float | int] = {"number": piece.number, "seed": piece.seed}
    found["world_s"] = time.process_time() - began[1]
    if piece.number >= 0:
        found |= _mapped(first, piece)
        found["streets_km"] = _streets_km(drives[0])
    started = time.process_time()
    if piece.queries:
        again = drives[0 if piece.number < 0 else 1]
        found["queries"] = _queried(again, drives[0].truth, piece)
    found["queries_s"] = time.process_time() - started
    found["wall_s"], found["cpu_s"] = time.time() - began[0], time.process_time() - began[1]
    with replacing(piece.record) as stream:
        stream.write(json.dumps(found).encode())
    return True


def _placed(drive: SimulatedSequence, piece: Piece) -> Reposed:
    return Reposed(drive, piece.T_city_town @ drive.truth)


def _mapped(drive: Reposed, piece: Piece) -> dict[str, float | int]:
    """Build the map as by default; how many segments were described for it is counted, too."""
    began, config = time.process_time(), Config(threads=1)
    all_of_it = config.mapping.model_copy(update={"compact": CompactConfig(enabled=False)})
    whole = build_map(drive, config.model_copy(update={"mapping": all_of_it}))
    whole.metadata["config"] = Config().to_yaml()
    prior_map = compacted(whole, config.mapping.compact)
    prior_map.save(piece.map_file)
    return {
        "map_s": time.process_time() - began,
        "km": float(geometry.distance_travelled(drive.poses)[-1]) / 1e3,
        "described": len(whole),
        "segments": len(prior_map),
        "bytes": piece.map_file.stat().st_size,
    }


def _streets_km(drive: SimulatedSequence) -> float:
    """Of the path, without what was driven before: steps into squares that are new to it."""
    positions = drive.truth[:, :3, 3]
    squares = list(map(tuple, np.floor(positions[:, :2] / SQUARE_M)))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    left, new = set(), 0.0
    for (here, there), step in zip(pairwise(squares), steps, strict=True):
        if here != there:
            left.add(here)
        new += step if there not in left else 0.0
    return new / 1e3


def _queried(drive: SimulatedSequence, path: Float64, piece: Piece) -> int:
    """Keep the clouds of some queries, gathered by noisy odometry, and where they were taken."""
    positions = query_positions(drive.truth, EVERY_M, MAX_GAP_M)[2:]
    near = distances_to_path(drive.truth[positions], path) <= COVERAGE_RADIUS_M
    chosen = positions[near]
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(piece.queries, len(chosen))).astype(int)]
    truths = piece.T_city_town @ drive.truth
    clouds = query_clouds(drive.with_odometry(), chosen, Config(threads=1))
    for k, ((cloud, _), at) in enumerate(zip(clouds, chosen, strict=True)):
        name = piece.folder / f"query-{piece.seed}-{k:02d}.npz"
        with replacing(name) as stream:
            np.savez(
                stream,
                points=cloud.points,
                T_local_sensor=cloud.T_local_sensor,
                num_scans=cloud.num_scans,
                voxel_size=cloud.voxel_size or 0.0,
                truth=truths[at],
            )
    return len(chosen)


def queries(folder: Path, seeds: list[int]) -> list[Path]:
    """The files of all queries of some towns, town by town."""
    return [path for seed in seeds for path in sorted(folder.glob(f"query-{seed}-*.npz"))]


def opened(path: Path) -> tuple[LocalCloud, Pose]:
    """A query's cloud, and where it was taken."""
    with np.load(path) as file:
        voxel = float(file["voxel_size"]) or None
        T = file["T_local_sensor"]
        cloud = LocalCloud(file["points"], T, int(file["num_scans"]), voxel_size=voxel)
        return cloud, file["truth"]


def widened(tiles: Path, out: Path, times: int) -> int:
    """Write the tiles again with a thin map of ``times`` as many segments; how many these are.

    The files of the tiles are those that are there, under a second name.
    """
    out.mkdir(parents=True, exist_ok=True)
    opened = TiledMap(tiles)
    for tile in opened.index.tiles:
        if not (out / tile.file).exists():
            os.link(tiles / tile.file, out / tile.file)
    larger = among_copies(opened.coarse(), times)
    coarse = write_tile(store_of(out), larger, "coarse")
    index = opened.index.model_copy(update={"coarse": coarse})
    with replacing(out / INDEX) as stream:
        stream.write(index.model_dump_json().encode())
    return len(larger)


def among_copies(thin: SegmentMap, times: int) -> SegmentMap:
    """Return a map with ``times - 1`` noisy copies of itself beside it."""
    larger, rng = thin.crop((0.0, 0.0), math.inf), np.random.default_rng(times)
    width_m = float(np.ptp(thin.centroids[:, 0])) + APART_M
    spread = SPREAD * thin.vectors.std(axis=0)
    for k in range(1, times):
        vectors = thin.vectors + rng.normal(0, spread, thin.vectors.shape)
        centroids = thin.centroids + rng.normal(0, SHIFT_M, thin.centroids.shape)
        larger.add(
            Descriptors(vectors.astype(np.float32), thin.quality),
            centroids + np.array([k * width_m, 0.0, 0.0]),
            thin.sizes,
            session=k,
            stamp=0.0,
            cloud=np.empty((0, 3)),
        )
    return larger
