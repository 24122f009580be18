"""Rivals on the drives of kidnapped robots: trackers, and systems that answer one scan at a time.

    python -m segloc_lab.protocols.rivals --worlds 7 --out rivals.jsonl

Robots and counts are those of ``segloc_lab.protocols.kidnapping --alike``: each drives 40 m along
the map, is put unnoticed to the place whose view is most alike, and drives on for 100 m. All
systems get the same scans and the same odometry.

- ``segloc`` begins without a pose. It is ``segloc live``'s core.
- ``particle-filter`` gets a pose near the true one at the first scan within 3 m of the mapped
  path, half a metre and five degrees off by standard deviations, and the grid of ``segloc export
  --to nav2``, of the storey it begins on. It always has a pose; in a second row it counts as
  localized while at least 90 % of its particles lie within a metre and 20 degrees of that pose.
- ``scan-context`` and ``contour-context``, with GICP and overlap, answer every scan anew, turned
  level by the odometry. They accept answers above a threshold that is chosen on the other worlds:
  halfway between the highest score of a wrong answer and the next score of a right one above it. It
  takes two worlds at least.

Each line that is kept is a robot followed by a system. Processor times are of one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import functools
import itertools
import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from segloc import geometry
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.tools.export import nav2
from segloc.types import Float64

from ..outcomes import pose_error
from ..peers.compare import threshold
from ..peers.contour_context import ContourContexts
from ..peers.contour_context import Settings as ContourSettings
from ..peers.exchange import Clouds
from ..peers.export import VIEW_EVERY_M, VIEWS_M, views
from ..peers.particle_filter import Grid, ParticleFilter, planar
from ..peers.particle_filter import Settings as FilterSettings
from ..peers.scan_context import Candidate, Places, Query, ScanContexts, sideways
from ..peers.study import checked
from ..recordings import Cached
from ..report import Cell, Table, publish, share
from ..runner import Runner
from .kidnapping import (
    ALIKE,
    ALIKE_KINDS,
    OFF_DEG,
    OFF_M,
    Carried,
    Localized,
    Trial,
    World,
    became,
    events,
    world_of,
)

GRID = nav2.GridOptions(resolution_m=0.1)
START_M, START_RAD = 0.5, np.radians(5.0)
"""Standard deviations of the pose that the particle filter gets to begin with."""
AGREED = 0.9
RADIUS_INDOORS_M, RADIUS_M = 50.0, 80.0
TOP = 3
ALL_POSES, AGREED_POSES = "particle filter, every pose", "particle filter, 90 % agree"
ONCE = {
    "scan-context": "Scan Context in NumPy, GICP, overlap",
    "contour-context": "Contour Context in NumPy, GICP, overlap",
}


@dataclass(frozen=True)
class Followed:
    """A robot followed by a system.

    Attributes
    ----------
    first : int
        Scan at its new place.
    path_m : list of float
        Distance travelled from there on, scan by scan.
    spacing_m : float
    within : list of bool
        Whether a scan lies within 3 m of the mapped path.
    right : list of bool
        Whether its pose is within the tolerance.
    scores : list of float or None
        How sure the system is, scan by scan; None without a pose. segloc: 1 while localized.
    ms : float
        Processor time of a scan, mean.
    """

    seed: int
    number: int
    scene: str
    sensor: str
    system: str
    first: int
    path_m: list[float]
    spacing_m: float
    within: list[bool]
    right: list[bool]
    scores: list[float | None]
    ms: float

    def localized(self, least: float) -> Localized:
        """Return what counts as localized with scores above a threshold."""
        sure = np.array([s is not None and s > least for s in self.scores], dtype=bool)
        right = np.array(self.right, dtype=bool)
        return Localized(sure & right, sure & ~right, np.zeros(len(sure), dtype=bool))

    def trial(self, least: float) -> Trial:
        """Return what became of the robot with that threshold."""
        found = self.localized(least)
        known = events(found, self.first, np.array(self.path_m), self.spacing_m)
        return Trial(
            *(self.seed, self.number, self.scene, self.sensor, ALIKE), **known, carried_on=0.0
        )


Answer = tuple[Float64 | None, float | None]
"""T_map_sensor of a scan and its score; None without."""


class Prepared:
    """What rivals keep of a world's map, made when a system first needs it."""

    def __init__(self, world: World) -> None:
        self.world = world

    def within(self, truths: Float64) -> NDArray[np.bool_]:
        """Return which poses lie within map coverage, (N,) bool."""
        path = self.world.localizer.prior_map.trajectory
        return distances_to_path(truths, path) <= COVERAGE_RADIUS_M

    @functools.cache  # noqa: B019, as long as the world
    def carried(self, number: int) -> Carried | None:
        """Return the drive of a robot; none if the drive does not meet the map."""
        return self.world.carried_alike(number) if len(self.world.known) else None

    @cached_property
    def views(self) -> Clouds:
        return views(Cached(self.world.mapped), VIEWS_M["scan"], VIEW_EVERY_M["scan"])

    @cached_property
    def places(self) -> Places:
        return Places(self.views)

    @cached_property
    def scan_contexts(self) -> ScanContexts:
        indoors = self.world.kind.platform is not None
        return ScanContexts(self.views, RADIUS_INDOORS_M if indoors else RADIUS_M)

    @cached_property
    def contour_contexts(self) -> ContourContexts:
        return ContourContexts(self.views, ContourSettings())

    def prepare(self, system: str) -> None:
        """Make what a system keeps of the map before the first scan comes."""
        if system == "particle-filter":
            assert self.grids
        elif system in ONCE:
            assert self.scan_contexts and self.contour_contexts
            for view in range(len(self.views)):
                self.places.target(view)

    @cached_property
    def grids(self) -> list[tuple[float, Grid]]:
        """The grid of each storey, and the height of its viewpoints [m]."""
        reach_m = FilterSettings().reach_m
        with TemporaryDirectory() as folder:
            notes = nav2.write_nav2(self.world.localizer.prior_map, Path(folder), GRID)
            storeys = [re.match(r"(map_\d+): .* z = (\S+) m", note) for note in notes]
            named = [(float(found[2]), found[1]) for found in storeys if found] or [(0.0, "map")]
            return [(z, Grid.load(Path(folder) / f"{name}.yaml", reach_m)) for z, name in named]


def segloc(known: Prepared, carried: Carried, number: int) -> tuple[list[bool], list[float | None]]:
    """Follow a robot by segloc."""
    found = known.world.followed(carried)
    sure = found.right | found.false
    return found.right.tolist(), [1.0 if each else None for each in sure.tolist()]


def particle_filter(known: Prepared, carried: Carried, number: int) -> list[Answer]:
    """Follow a robot by a particle filter that begins near its true pose, where the map begins."""
    settings, truths = FilterSettings(), known.world.truths_of(carried)
    first = int(known.within(truths).argmax())
    truth = truths[first]
    _, grid = min(known.grids, key=lambda each: abs(each[0] - truth[2, 3]))
    followed = ParticleFilter(grid, settings, known.world.seed + number)
    rng = np.random.default_rng([known.world.seed, number, 1])
    begin = np.array([truth[0, 3], truth[1, 3], geometry.heading(truth)])
    x, y, yaw = (begin + rng.normal(0.0, (START_M, START_M, START_RAD))).tolist()
    followed.start((x, y, yaw), START_M, START_RAD)
    answers: list[Answer] = [(None, None)] * first
    before = geometry.levelled(carried.poses[first])
    for k, T in enumerate(carried.poses[first:], first):
        now = geometry.levelled(T)
        step = geometry.inverse(before) @ now
        before = now
        level = geometry.transform(geometry.inverse(now) @ T, carried.scan(k).points)
        beams = planar(level, GRID, settings.longest_m)
        followed.update((float(step[0, 3]), float(step[1, 3]), geometry.heading(step)), beams)
        (x, y, yaw), agreed = followed.estimate()
        # Its height is not of this filter: the true one stands in for it.
        z = float(truths[k, 2, 3])
        tilt = geometry.inverse(now) @ T
        answers.append((geometry.yaw_transform(yaw, (x, y, z)) @ tilt, agreed))
    return answers


def answered(
    known: Prepared, carried: Carried, propose: Callable[[NDArray[np.float32]], list[Candidate]]
) -> list[Answer]:
    """Answer each scan by the best of the proposed places, after GICP and by overlap."""
    answers: list[Answer] = []
    for k, T in enumerate(carried.poses):
        tilt = geometry.inverse(geometry.levelled(T)) @ T
        points = geometry.transform(tilt, carried.scan(k).points).astype(np.float32)
        query, places = Query(points), known.places
        found = [places.refined(query, c.T_map_query, c.view) for c in propose(points)]
        if found:
            best, overlap = max(found, key=lambda item: item[1])
            answers.append((best @ tilt, overlap))
        else:
            answers.append((None, None))
    return answers


def scan_context(known: Prepared, carried: Carried, number: int) -> list[Answer]:
    """Answer each scan by Scan Context."""
    contexts = known.scan_contexts
    return answered(known, carried, lambda p: contexts.candidates(p, sideways([0.0]), TOP))


def contour_context(known: Prepared, carried: Carried, number: int) -> list[Answer]:
    """Answer each scan by Contour Context."""
    return answered(known, carried, known.contour_contexts.candidates)


RIVALS = {
    "particle-filter": particle_filter,
    "scan-context": scan_context,
    "contour-context": contour_context,
}
SYSTEMS = ("segloc", *RIVALS)


def follow(known: Prepared, carried: Carried, number: int, system: str) -> Followed:
    """Follow a robot by a system."""
    world, truths = known.world, known.world.truths_of(carried)
    for k in range(len(carried)):
        carried.scan(k)  # rays are cast before anything is timed
    known.prepare(system)
    begun = time.process_time()
    if system == "segloc":
        right, scores = segloc(known, carried, number)
    else:
        answers = RIVALS[system](known, carried, number)
        right = [_is_right(T, truth) for (T, _), truth in zip(answers, truths, strict=True)]
        scores = [None if score is None else round(score, 4) for _, score in answers]
    spent_ms = 1e3 * (time.process_time() - begun) / len(truths)
    within = known.within(truths)
    return Followed(
        *(world.seed, number, world.kind.scene, world.kind.sensor, system, carried.first),
        np.round(geometry.distance_travelled(truths[carried.first :]), 2).tolist(),
        *(world.kind.spacing_m, within.tolist(), right, scores, round(spent_ms, 2)),
    )


def _is_right(T: Float64 | None, truth: Float64) -> bool:
    metres, degrees = pose_error(T, truth)
    return metres <= OFF_M and degrees <= OFF_DEG


NOTE = (
    "Right: localized within 2 m and 10 degrees, of the scans within 3 m of the mapped path, "
    "before and after the robot is carried away. Noticed, recovered: of those known before. False: "
    "metres of a trial localized farther off than that. The particle filter alone is given a pose "
    "near the true one, where the robot first meets the map. A system that answers one scan at a "
    "time is localized at the scans whose answer it accepts. segloc works at a query every 2 m and "
    "checks between, the others at every scan."
)


def table(found: list[Followed]) -> Table:
    """Return a row per system."""
    rows: list[dict[str, Cell]] = []
    for system in (s for s in SYSTEMS if any(f.system == s for f in found)):
        here = [f for f in found if f.system == system]
        if system == "particle-filter":
            rows += [_row(ALL_POSES, here, [-1.0] * len(here))]
            rows += [_row(AGREED_POSES, here, [AGREED - 1e-9] * len(here))]
        elif system in ONCE:
            rows.append(_row(ONCE[system], here, [_threshold(here, f.seed) for f in here]))
        else:
            rows.append(_row(system, here, [0.0] * len(here)))
    return Table.of(rows, NOTE)


def _threshold(found: Iterable[Followed], seed: int) -> float:
    """Return the threshold that all other worlds imply."""
    pairs = [
        (score, right)
        for each in found
        if each.seed != seed
        for score, right in zip(each.scores, each.right, strict=True)
        if score is not None
    ]
    values, right = (np.array(part) for part in zip(*pairs, strict=True)) if pairs else ([], [])
    is_right = np.asarray(right, dtype=bool)
    scores = np.asarray(values, dtype=np.float64)
    return threshold(scores[~is_right], scores[is_right])


def _row(name: str, found: list[Followed], least: list[float]) -> dict[str, Cell]:
    trials = [each.trial(limit) for each, limit in zip(found, least, strict=True)]
    within = np.concatenate([each.within for each in found])
    localized = [each.localized(limit).right for each, limit in zip(found, least, strict=True)]
    right = int((np.concatenate(localized) & within).sum())
    ms = float(np.mean([each.ms for each in found]))
    seen = {"system": name, "right, of scans in the map": share(right, int(within.sum()))}
    return {**seen, **became(trials), "processor ms a scan": round(ms, 1)}


def followed_of(results: Iterable[Mapping[str, Any]]) -> list[Followed]:
    """Return what robots did by results, each once."""
    found = {(each["seed"], each["number"], each["system"]): Followed(**each) for each in results}
    return [found[key] for key in sorted(found)]


def report(found: list[Followed], folder: Path | None) -> None:
    """Publish the table."""
    publish(folder, "Rivals on the drives of kidnapped robots", table(found))


def main() -> None:
    runner = Runner(
        __doc__, "rivals.jsonl", first_seed=67000, worlds=7, choosing=("trials", "systems")
    )
    add = runner.options.add_argument
    add("--trials", type=int, default=1, help="in each world")
    add("--systems", nargs="+", default=list(SYSTEMS), help=", ".join(SYSTEMS))
    args = runner.parse()

    prepared = functools.lru_cache(maxsize=1)(Prepared)

    def followed(task: tuple[int, int, str]) -> dict[str, Any] | None:
        seed, number, system = task
        known = prepared(world_of(ALIKE_KINDS, seed))
        carried = known.carried(number)
        return None if carried is None else asdict(follow(known, carried, number, system))

    systems = checked(args.systems, SYSTEMS, "--systems")
    tasks = itertools.product(runner.seeds, range(args.trials), systems)
    report(followed_of(runner.run(followed, tasks, ("seed", "number", "system"))), args.report)


if __name__ == "__main__":
    main()
