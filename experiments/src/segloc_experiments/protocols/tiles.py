r"""KITTI 00 in tiles: what is found with and without a prior, beside the map in one piece.

Queries are those of ``protocols.real``; a prior is the true position, moved at random within half
of its radius, or one at another place of the map.

    python -m segloc_experiments.protocols.tiles DATA OUT --size 250
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from segloc import Config, Localization, Localizer, Prior, SegmentMap, build_map
from segloc.batch.run import query_clouds
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path
from segloc.search import Query
from segloc.tiles import TiledMap, cut_tiles
from segloc.types import Float64, Pose

from .. import kitti00
from ..script import head, parser, row
from .real import outcome

RADIUS_M, FAR_M = 50.0, 80.0
SETS = ("accumulated", "sparse")


def described(
    data: Path, name: str, localizer: Localizer, path: Float64, step: int
) -> Iterator[tuple[Query, Pose]]:
    """The queries within map coverage, and where they were taken."""
    chosen = kitti00.query_set(data, name)
    truths = chosen.truths
    assert truths is not None
    near = distances_to_path(truths, path) <= COVERAGE_RADIUS_M
    rows = np.flatnonzero(near)[::step]
    clouds = query_clouds(chosen.recording, chosen.positions[rows], localizer.config)
    for (cloud, times), truth in zip(clouds, truths[rows], strict=True):
        yield localizer.describe(cloud, times), truth


def elsewhere(truth: Pose, path: Float64, rng: np.random.Generator) -> Float64:
    """A place of the map that is not near the truth."""
    distances = np.linalg.norm(path[:, :2, 3] - truth[:2, 3], axis=1)
    far: Float64 = path[distances > RADIUS_M + FAR_M, :2, 3]
    chosen: Float64 = far[rng.integers(len(far))]
    return chosen


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--size", type=float, default=250.0, help="edge of a tile, metres")
    options.add_argument("--step", type=int, default=1, help="one of so many queries")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / f"first-{args.method}.segmap"
    if not file.exists():
        build_map(kitti00.mapped(args.data, "sparse"), config).save(file)
    whole = SegmentMap.load(file)
    index = cut_tiles(whole, args.out / "tiles", size_m=args.size)
    tiled = Localizer(TiledMap(args.out / "tiles"), config)
    bytes_of_tiles = sum(tile.bytes for tile in index.tiles) / 1e6
    thin = index.coarse.bytes / 1e6
    print(f"{len(index.tiles)} tiles of {bytes_of_tiles:.2f} MB, thin map {thin:.2f} MB")
    print(f"in one piece {file.stat().st_size / 1e6:.2f} MB")
    localizer, rng = Localizer(whole, config), np.random.default_rng(0)
    path = whole.trajectory

    def moved(T: Pose) -> Prior:
        return Prior(T[:2, 3] + rng.uniform(-0.5, 0.5, 2) * RADIUS_M, RADIUS_M)

    def wrong(T: Pose) -> Prior:
        return Prior(elsewhere(T, path, rng), RADIUS_M)

    ways: dict[str, Callable[[Query, Pose], Localization]] = {
        "in one piece": lambda query, _: localizer.locate(query),
        "in one piece, prior": lambda query, T: localizer.locate(query, near=moved(T)),
        "in one piece, wrong prior": lambda query, T: localizer.locate(query, near=wrong(T)),
        "in tiles": lambda query, _: tiled.locate(query),
        "in tiles, prior": lambda query, T: tiled.locate(query, near=moved(T)),
        "in tiles, wrong prior": lambda query, T: tiled.locate(query, near=wrong(T)),
    }
    print(head("queries", "way", "number", "found", "false", "ms, median", "mean"))
    for name in SETS:
        queries = list(described(args.data, name, localizer, path, args.step))
        for way, locate in ways.items():
            outcomes, spent = [], []
            for query, truth in queries:
                start = time.process_time()
                answer = locate(query, truth)
                spent.append(1e3 * (time.process_time() - start))
                outcomes.append(outcome(answer.T_map_sensor, truth))
            counts = len(queries), outcomes.count("found"), outcomes.count("false")
            times = f"{np.median(spent):.0f}", f"{np.mean(spent):.0f}"
            print(row(name, way, *counts, *times), flush=True)


if __name__ == "__main__":
    main()
