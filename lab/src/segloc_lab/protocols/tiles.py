r"""KITTI 00 in tiles: what is found with and without a prior, beside the map in one piece.

Queries are those of ``protocols.real``; a prior is the true position, moved at random within half
of its radius, or one at another place of the map.

    python -m segloc_lab.protocols.tiles DATA OUT
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from segloc import Config, Localization, Localizer, Prior, SegmentMap, build_map
from segloc.proposals import Query
from segloc.tiles import TiledLocalizer, TiledMap, cut_tiles
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path, query_clouds
from segloc.types import Float64, Pose

from .. import kitti00
from ..outcomes import outcome
from ..report import Cell, Table, publish, reporting, share

RADIUS_M, FAR_M = 50.0, 80.0
SETS = ("accumulated", "sparse")


def described(
    data: Path, name: str, localizer: Localizer, path: Float64, step: int
) -> Iterator[tuple[Query, Pose]]:
    """Return the queries within map coverage, and their true poses."""
    chosen = kitti00.query_set(data, name)
    truths = chosen.truths
    assert truths is not None
    near = distances_to_path(truths, path) <= COVERAGE_RADIUS_M
    rows = np.flatnonzero(near)[::step]
    clouds = query_clouds(chosen.recording, chosen.positions[rows], localizer.config)
    for (cloud, times), truth in zip(clouds, truths[rows], strict=True):
        yield localizer.describe(cloud, times), truth


def elsewhere(truth: Pose, path: Float64, rng: np.random.Generator) -> Float64:
    """Return a place of the map far from the truth."""
    distances = np.linalg.norm(path[:, :2, 3] - truth[:2, 3], axis=1)
    far: Float64 = path[distances > RADIUS_M + FAR_M, :2, 3]
    chosen: Float64 = far[rng.integers(len(far))]
    return chosen


Way = Callable[[Query, Pose], Localization]


def ways(localizer: Localizer, path: Float64, rng: np.random.Generator) -> dict[str, Way]:
    """Return how each query is localized; ``path`` is the mapped one, (P, 4, 4)."""

    def right(T: Pose) -> Prior:
        return Prior(T[:2, 3] + rng.uniform(-0.5, 0.5, 2) * RADIUS_M, RADIUS_M)

    def wrong(T: Pose) -> Prior:
        return Prior(elsewhere(T, path, rng), RADIUS_M)

    return {
        "": lambda query, _: localizer.locate(query),
        ", prior": lambda query, T: localizer.locate(query, near=right(T)),
        ", wrong prior": lambda query, T: localizer.locate(query, near=wrong(T)),
    }


def measured(queries: list[tuple[Query, Pose]], locate: Way) -> Iterator[Cell]:
    """Count what is found and false, and the processor time of a query."""
    outcomes, spent = [], []
    for query, truth in queries:
        start = time.process_time()
        answer = locate(query, truth)
        spent.append(1e3 * (time.process_time() - start))
        outcomes.append(outcome(answer.T_map_sensor, truth))
    yield share(outcomes.count("found"), len(queries))
    yield outcomes.count("false")
    yield from (round(float(mean(spent)), 1) for mean in (np.median, np.mean))


def cut_of(tiles: TiledMap, size_m: float) -> str:
    """Describe how a map was cut."""
    index = tiles.index
    of_tiles = sum(tile.bytes for tile in index.tiles) / 1e6
    return (
        f"{len(index.tiles)} tiles of {size_m:g} m with their margins {of_tiles:.1f} MB, "
        f"their thin map {index.coarse.bytes / 1e6:.1f} MB"
    )


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument(
        "--sizes", type=float, nargs="+", default=[250.0, 100.0], help="edges of tiles, metres"
    )
    options.add_argument("--step", type=int, default=1, help="use every STEP-th query")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / f"first-{args.method}.segmap"
    if not file.exists():
        build_map(kitti00.mapped(args.data, "sparse"), config).save(file)
    whole = SegmentMap.load(file)
    places, cuts = {"in one piece": Localizer(whole, config)}, []
    for size in args.sizes:
        folder = args.out / f"tiles-{size:g}"
        cut_tiles(whole, folder, size_m=size)
        tiles = TiledMap(folder)
        cuts.append(cut_of(tiles, size))
        places[f"in tiles of {size:g} m"] = TiledLocalizer(tiles, config)
    rows: list[tuple[Cell, ...]] = []
    for name in SETS:
        queries = list(
            described(args.data, name, places["in one piece"], whole.trajectory, args.step)
        )
        rng = np.random.default_rng(0)
        for place, localizer in places.items():
            for prior, locate in ways(localizer, whole.trajectory, rng).items():
                rows.append((name, place + prior, *measured(queries, locate)))
    note = (
        f"`{args.method}`; {file.stat().st_size / 1e6:.1f} MB in one piece; {'; '.join(cuts)}. "
        "Milliseconds of processor time of one thread, on a machine with other work; in brackets "
        "95 % by Wilson."
    )
    columns = ("queries", "way", "found", "false", "ms, median", "mean")
    publish(args.report, "KITTI 00 in tiles", Table(columns, rows, note))


if __name__ == "__main__":
    main()
