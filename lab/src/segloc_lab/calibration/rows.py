"""Collect what the posterior is fitted to: the measures of all refined poses of simulated queries.

Each query of a world (:mod:`.worlds`) is searched in several maps: its own, the first half of it,
its mirror image, its own among other places (60 000 segments), the map of another world of the same
kind, and of another kind. Measures are kept raw, so that features can change without collecting
anew. One file a world; files that exist are kept.

    python -m segloc_lab.calibration.rows rows/fit --out rows/measured
"""

from __future__ import annotations

import math
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.progress import track

from segloc import Config, Localizer, Scan, SegmentMap
from segloc.likelihood import aligned_measures, walls_over
from segloc.proposals import Query
from segloc.types import Float32, Float64, Int64, Pose

from ..outcomes import pose_error
from ..padding import mirrored, padded
from ..runner import Entry, Runner
from ..script import parser
from .worlds import KINDS, Made, bare, generated, kind_of, load_queries, seed_of

PADDED = 60_000
"""Segments of a padded map."""
MAPS = ("own", "half", "mirrored", "padded", "same kind", "other kind")
ALTERNATE = ({"mirrored"}, {"padded", "other kind"})
"""Maps in which only even and only odd queries are searched."""
BARE = "bare"
"""Place of made views, which are searched in the own map."""
HOME = ("own", "half", "padded")
"""Maps in which a query may have a right pose."""
ROUGH, ALIGNED = ("rough_odds", "rough_over", "rough_inliers"), ("aligned_odds", "aligned_seen")
"""What is known of a pose before alignment, and after alignment with some of the points."""
MEASURES = (
    "error_m",
    "error_deg",
    "inliers",
    "elsewhere",
    "seen",
    "in_view",
    "ground",
    "ground_of",
    "on_surface",
    "on_surface_of",
    "known_on",
    "known_off",
    "known_of",
    "inside",
    "inside_of",
    "planes",
    "planes_of",
    "walls",
    *ROUGH,
    *ALIGNED,
)
"""Columns of the fits: error of the pose (NaN in maps of other places), segments that agree with it
and at most with a pose elsewhere, counts of points with their totals, walls over those of other
places, and what was known before the measurement."""
DECIMALS = {"error_deg": 1} | dict.fromkeys(("error_m", "walls", *ROUGH, *ALIGNED), 2)
"""Decimals that are kept of measures that are no counts."""


Names = NDArray[np.str_]


@dataclass(frozen=True)
class Rows:
    """What was measured of queries in maps.

    Attributes
    ----------
    fits : (F, M) float32
        Columns are :data:`MEASURES`.
    spans : (R, 2) int64
        First row of ``fits`` of each record (a query in a map), and the row after its last.
    query : (R,) int64
        Number of the query in its world.
    world, place, sensor, made : (R,) str
        Name of the world, map (of :data:`MAPS`), sensor, and whether the query is accumulated,
        single or thinned.
    """

    fits: Float32
    spans: Int64
    query: Int64
    world: Names
    place: Names
    sensor: Names
    made: Names

    def __len__(self) -> int:
        return len(self.spans)

    def save(self, path: Path) -> None:
        """Write the rows; the file appears when it is complete."""
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, **{f.name: getattr(self, f.name) for f in fields(self)})
        part.rename(path)

    @classmethod
    def load(cls, path: Path) -> Rows:
        """Read what :meth:`save` wrote."""
        with np.load(path) as file:
            return cls(**{f.name: file[f.name] for f in fields(cls)})

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """Join the rows of several worlds."""
        before = np.cumsum([0, *(len(part.fits) for part in parts)])
        moved = [
            replace(part, spans=part.spans + k) for part, k in zip(parts, before, strict=False)
        ]
        names = [f.name for f in fields(cls)]
        return cls(**{n: np.concatenate([getattr(part, n) for part in moved]) for n in names})


class World:
    """The maps and queries of a world that was generated.

    Parameters
    ----------
    folder : path
        Of the world.
    same, other : path
        Of a world of the same kind, and of one of another kind.
    """

    def __init__(self, folder: Path, same: Path, other: Path) -> None:
        self.name, self._folder, self._same, self._other = folder.name, folder, same, other
        self.kind = kind_of(folder)

    def queries(self) -> Iterator[Made]:
        """Yield all queries, drive by drive, then narrow views, then made ones."""
        drives = load_queries(self._folder / "queries.npz")
        for each in drives:
            yield from each
        for each in drives:
            yield from each.narrow()
        yield from bare(seed_of(self._folder))

    def drives(self) -> Iterator[tuple[list[Scan], Float64]]:
        """Yield all scans of each drive, with odometry poses, and their true poses (S, 4, 4)."""
        for each in load_queries(self._folder / "queries.npz"):
            yield each.scans(), each.truth

    @cached_property
    def maps(self) -> dict[str, SegmentMap]:
        """The maps to search, by their names of :data:`MAPS`."""
        own, same = (SegmentMap.load(p / "own.segmap") for p in (self._folder, self._same))
        found = {"own": own, "half": SegmentMap.load(self._folder / "half.segmap")}
        if not KINDS[self.kind].alike:
            found["mirrored"] = mirrored(own)
        found["padded"] = padded(own, [same], PADDED)
        other = SegmentMap.load(self._other / "own.segmap")
        return found | {"same kind": same, "other kind": other}

    def searched(self, query: int, made: Made) -> list[str]:
        """List the maps in which a query, by its number, is searched."""
        if made.truth is None:
            return ["own"]
        return [name for name in self.maps if name not in ALTERNATE[1 - query % 2]]


def worlds_of(folder: Path) -> list[World]:
    """List the complete worlds of a folder, by seed, each with two others to be lost in."""
    found = generated(folder)
    kinds = [kind_of(path) for path in found]
    listed = []
    for k, (path, kind) in enumerate(zip(found, kinds, strict=True)):
        around = [(k - step) % len(found) for step in range(1, len(found))]
        same = next((j for j in around if kinds[j] == kind), None)
        other = next((j for j in around if kinds[j] != kind), None)
        if same is not None and other is not None:
            listed.append(World(path, found[same], found[other]))
    return listed


def collect(world: World, config: Config) -> Rows:
    """Search every query of a world in all of its maps."""
    places = {name: Localizer(prior_map, config) for name, prior_map in world.maps.items()}
    fits: list[Float64] = []
    records: list[tuple[int, str, str, str, str]] = []
    for n, made in enumerate(world.queries()):
        query = places["own"].describe(made.scans)
        for name in world.searched(n, made):
            truth = made.truth if name in HOME else None
            fits.append(measured(places[name], query, truth))
            place = name if made.truth is not None else BARE
            records.append((n, world.name, place, made.sensor, made.kind))
    ends = np.cumsum([len(rows) for rows in fits])
    spans = np.column_stack([np.concatenate([[0], ends[:-1]]), ends])
    columns = map(np.array, zip(*records, strict=True))
    return Rows(rounded(np.concatenate(fits)), spans, *columns)


def measured(localizer: Localizer, query: Query, truth: Pose | None) -> Float64:
    """Measure a query in a map at all distinct poses that are compared there, (F, M)."""
    found = localizer.search(query, thorough=True)
    places = [place for place in found.places if place.fit is not None]
    apart = localizer.likelihood.separation.apart
    rows = []
    for place in places:
        T, fit = place.T_map_local, place.fit
        assert fit is not None and place.aligned is not None and place.beside is not None
        error = errors(T @ query.cloud.T_local_sensor, truth)
        far = [p.fit for p in places if p.fit is not None and apart(p.T_map_local, T)]
        elsewhere = [o.inliers for o in found.candidates if apart(o.T_map_local, T)]
        most = max([*elsewhere, *(other.inliers for other in far)], default=0)
        counts = (*fit.seen, *fit.ground, *fit.on_surface, *fit.known, *fit.inside, *fit.planes)
        walls = walls_over(fit.walls, place.beside)
        before = (*place.measures, *aligned_measures(place.aligned))
        rows.append((*error, fit.inliers, most, *counts, walls, *before))
    return np.array(rows, np.float64).reshape(-1, len(MEASURES))


def rounded(fits: Float64) -> Float32:
    """Round measures, and order them by column: so they compress well."""
    found = np.asfortranarray(fits, np.float32)
    for name, decimals in DECIMALS.items():
        column = MEASURES.index(name)
        found[:, column] = np.round(found[:, column], decimals)
    return found


def errors(T_map_sensor: Pose, truth: Pose | None) -> tuple[float, float]:
    """Compute the error of a pose [m, deg]; NaN where the map does not hold the place."""
    return (math.nan, math.nan) if truth is None else pose_error(T_map_sensor, truth)


RIGHT_M, RIGHT_DEG = 2.0, 5.0
"""Errors from which a pose is wrong, and an answer false: a hall turned by half is."""


def is_right(metres: ArrayLike, degrees: ArrayLike) -> NDArray[np.bool_]:
    """Return whether poses of these errors are right; NaN is wrong."""
    return (np.asarray(metres) < RIGHT_M) & (np.asarray(degrees) < RIGHT_DEG)


def run_in_worlds(
    doc: str | None, out: str, work: Callable[[World], Entry]
) -> tuple[Namespace, list[Entry]]:
    """Run a protocol in each world of a folder, its argument; return all arguments and results."""
    runner = Runner(doc, out, parallel=True, choosing=("every",))
    runner.options.add_argument("worlds", type=Path, help="folder of generated worlds")
    runner.options.add_argument("--every", type=int, default=1, help="take each Nth world")
    args = runner.parse()
    chosen = worlds_of(args.worlds)[:: args.every]
    return args, runner.run(work, chosen, ("world",), lambda world: [world.name])


def main() -> None:
    options = parser(__doc__)
    options.add_argument("worlds", type=Path, help="folder of generated worlds")
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--every", type=int, default=1, help="take each Nth world")
    options.add_argument("--first", type=int, default=0, help="number of the first world taken")
    args = options.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    config = Config(threads=1)
    chosen = worlds_of(args.worlds)[args.first :: args.every]
    for world in track(chosen, "worlds"):
        path = args.out / f"{world.name}.npz"
        if not path.exists():
            start = time.process_time()
            rows = collect(world, config)
            rows.save(path)
            seconds = time.process_time() - start
            print(f"{world.name}: {len(rows)} records, {len(rows.fits)} fits, {seconds:.0f} s")


if __name__ == "__main__":
    main()
