"""Forests localized from scans alone, with stems as a second proposer and without.

Simulated forests are mapped in summer by an HDL-64E. In a later session, with most leaves gone and
a fifth of what can be moved replaced, single scans of a VLP-16 are taken on the mapped path and 10
and 20 m beside it, wherever there is room for a sensor, and clouds are accumulated along the path
by odometry that drifts. Each query is also run in the mirror image of its map and in the map of
another forest, where nothing is to be found.

    python -m segloc_lab.protocols.forest_scans
    python -m segloc_lab.protocols.forest_scans --columns 300 --kept SCANS
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from segloc_stems import LandmarkLocalizer, LandmarkMap, StemFinder, find_stems

from segloc import Config, LocalCloud, Localization, Localizer, SegmentMap, build_map
from segloc.frontend import Accumulator
from segloc.tools.batch import distances_to_path, query_clouds
from segloc.types import Pose

from ..outcomes import pose_error
from ..padding import mirrored
from ..recordings import beside, has_room, kept
from ..report import Table, publish, reporting, share, wilson
from ..simulation import SCENES, Conditions, World
from .change import SIZES_M, SPINNING, drives, mapped_drive, query_sets, sensor_of

OFFSETS_M = (0.0, 10.0, 20.0)
BORDER_M = 3.0
RIGHT_M, RIGHT_DEG = 1.0, 5.0
NEAR_M, NEAR_DEG = 5.0, 10.0
LATER = Conditions(foliage=0.3, replaced=0.2)
CLOUDS = ("single", "accumulated")
MAPS = ("own", "mirrored", "another")

Locate = Callable[[LocalCloud], Localization]


@dataclass
class Tally:
    """Results of one method on queries of one kind."""

    queries: int = 0
    found: int = 0
    near: int = 0
    false: int = 0
    seconds: float = 0.0

    def add(self, answer: Localization, T_map_sensor: Pose | None, seconds: float) -> None:
        """Count a result; without a true pose every pose is false."""
        self.queries += 1
        self.seconds += seconds
        if not answer.localized:
            return
        metres, degrees = pose_error(answer.T_map_sensor, T_map_sensor)
        self.found += metres < RIGHT_M and degrees < RIGHT_DEG
        self.near += metres < NEAR_M and degrees < NEAR_DEG
        self.false += metres >= NEAR_M or degrees >= NEAR_DEG

    def cells(self) -> tuple[str, ...]:
        """Return its part of a row."""
        return (
            share(self.found, self.queries),
            str(self.near - self.found),
            f"{self.false} (below {100 * wilson(self.false, self.queries)[1]:.1f} %)",
            f"{1000 * self.seconds / max(self.queries, 1):.0f}",
        )


def methods(prior_map: SegmentMap) -> dict[str, Locate]:
    """Methods compared: segments and clouds, the same with stems, and stems alone."""
    config = Config(threads=1)
    alone = LandmarkLocalizer(stem_map(prior_map))
    return {
        "without stems": Localizer(prior_map, config).localize,
        "with stems": Localizer(
            prior_map, config.model_copy(update={"proposers": ("stems",)})
        ).localize,
        "stems alone": lambda cloud: alone.localize(find_stems(cloud)),
    }


def stem_map(prior_map: SegmentMap) -> LandmarkMap:
    """Return the stems in the cloud of a map."""
    stems = StemFinder().find(prior_map.cloud, spacing=prior_map.cloud_voxel)
    columns = stems.transform(np.eye(4))
    positions, views = columns[:, :3] + prior_map.origin, np.ones(len(stems), np.int64)
    return LandmarkMap(positions, columns[:, 3:6], columns[:, 6], views, prior_map.trajectory)


@dataclass(frozen=True)
class Forests:
    """Maps of simulated forests, and queries in them."""

    sensor: str
    columns: int
    beams: int | None
    map_sensor: str
    scans: Path | None

    def world(self, seed: int) -> World:
        return SCENES["forest"](seed, size_m=SIZES_M["forest"])

    def map(self, seed: int) -> SegmentMap:
        """Return the trajectory through one forest."""
        drive = mapped_drive(self.world(seed), seed, sensor_of(self.map_sensor))
        config = Config(threads=1)
        return build_map(kept(drive, self.scans), config)

    def single(self, seed: int, every: int) -> Iterator[tuple[LocalCloud, Pose]]:
        """Return scans on and beside the mapped trajectory, with true poses."""
        world, accumulator = self.world(seed), Accumulator()
        drive = mapped_drive(world, seed, sensor_of(self.sensor, self.columns, self.beams))
        later = replace(drive, session=1, conditions=LATER, seed=seed + 1)
        for offset in OFFSETS_M:
            for side in (offset, -offset) if offset else (0.0,):
                shifted = kept(beside(later, drive.truth[4::every], side, side < 0), self.scans)
                gaps = distances_to_path(shifted.truth, drive.truth)
                x, y = shifted.truth[:, :2, 3].T
                inside = np.minimum(x, y) > BORDER_M
                inside &= np.maximum(x, y) < SIZES_M["forest"] - BORDER_M
                for i in np.flatnonzero(inside & (gaps > offset - 1.0)):
                    scan = shifted.scan(int(i))
                    if has_room(scan, drive.sensor.mount_height_m):
                        alone = accumulator.gather(scan.points)
                        yield alone, shifted.truth[i]

    def accumulated(self, seed: int, every_m: float) -> Iterator[tuple[LocalCloud, Pose]]:
        """Return clouds along the trajectory in both directions, with true poses."""
        world, config = self.world(seed), Config()
        sensor = sensor_of(self.sensor, self.columns, self.beams)
        for drive in drives(world, seed, sensor, LATER).values():
            queries = query_sets(kept(drive, self.scans), 1, every_m)["accumulated"]
            clouds = query_clouds(queries.recording, queries.positions, config)
            assert queries.truths is not None
            for (cloud, _), truth in zip(clouds, queries.truths, strict=True):
                yield cloud, truth


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--seeds", type=int, nargs="+", default=[9100, 9101, 9102])
    options.add_argument("--other", type=int, default=9199, help="seed of the forest elsewhere")
    options.add_argument("--sensor", default="vlp16", choices=SPINNING, help="of the queries")
    options.add_argument("--columns", type=int, default=900, help="a turn of that sensor")
    options.add_argument("--beams", type=int, help="of that sensor; by default all")
    options.add_argument("--map-sensor", default="hdl64e", choices=SPINNING)
    options.add_argument("--clouds", nargs="+", default=list(CLOUDS), choices=CLOUDS)
    options.add_argument("--maps", nargs="+", default=list(MAPS), choices=MAPS)
    options.add_argument("--every", type=int, default=6, help="scans, 2 m apart, between queries")
    options.add_argument("--accumulated-every", type=float, default=12.0, metavar="METRES")
    options.add_argument("--kept", type=Path, metavar="SCANS", help="folder to keep scans in")
    args = options.parse_args()
    forests = Forests(args.sensor, args.columns, args.beams, args.map_sensor, args.kept)
    tallies: dict[tuple[str, str, str], Tally] = {}
    other = forests.map(args.other) if "another" in args.maps else None
    for seed in args.seeds:
        prior_map = forests.map(seed)
        places = {"own": prior_map, "mirrored": mirrored(prior_map), "another": other or prior_map}
        located = {place: methods(places[place]) for place in args.maps}
        for clouds in args.clouds:
            queries = (
                forests.single(seed, args.every)
                if clouds == "single"
                else forests.accumulated(seed, args.accumulated_every)
            )
            for cloud, truth in queries:
                for place, by_name in located.items():
                    for name, locate in by_name.items():
                        begin = time.process_time()
                        answer = locate(cloud)
                        seconds = time.process_time() - begin
                        tally = tallies.setdefault((clouds, place, name), Tally())
                        tally.add(answer, truth if place == "own" else None, seconds)
    columns = ("clouds", "map", "by", "found", "near", "false", "ms")
    rows = [(*key, *tally.cells()) for key, tally in tallies.items()]
    publish(args.report, "Forests from scans alone", Table(columns, rows))


if __name__ == "__main__":
    main()
