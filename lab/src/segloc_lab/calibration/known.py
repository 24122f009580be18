"""Fit what a view says about a pose that is known already: that of a tracker.

Each drive of the worlds (:mod:`.worlds`) is followed scan by scan, every 2 m, in the map of its
world and in the first half of it, past whose end the robot drives; a fifth of the things are
replaced. A scan is compared at the true pose, and at wrong ones: every :data:`EVERY`-th scan is
searched, and from the likeliest wrong places robots that believe to be there drive on by the same
odometry, as one that was carried to a place that looks alike does. Each drive is followed again
with narrow views, and with people around the sensor in every third scan.

The model is a logistic regression of right and wrong, each counted as much, fitted to what single
views, three and six in succession say together. What differs from the map, or looks like it
elsewhere, is seen again in the next view: how alike two views are decays with the way between them,
and how fast is fitted, too. The rows of the shipped model are kept beside this module, one array a
world.

    python -m segloc_lab.calibration.known --worlds rows/fit --every 3 --rows known.npz
    python -m segloc_lab.calibration.known --out src/segloc/weights/posterior*.json
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.optimize import minimize
from scipy.special import expit, logit

from segloc import Config, Localizer, Scan, geometry
from segloc.likelihood import Known, ScoredPose, by_name
from segloc.types import Float32, Float64, Int64, LocalCloud, Pose

from ..parallel import in_parallel
from ..report import Cell, Table, command, publish, reporting
from .rows import World, errors, is_right, worlds_of
from .worlds import kind_of, narrowed, seed_of

STEP_M = 2.0
"""Way between scans."""
EVERY, HELD = 6, 2
"""Scans between searches, and the wrong places held from each until the next."""
SEARCHED = ("own", "half")
WHOLE, NARROW, CROWDED = range(3)
"""Ways of seeing."""
CROWD, CROWD_M, CROWD_SHARE = 3, (0.8, 3.0), (0.5, 0.9)
"""Scans of which one is crowded, distance of the people, and the share of directions they block."""
USED = ("seen_over_rival", "walls_over_rival")
"""Features of the model: with the others wrong poses of other worlds are believed more."""
COLUMNS = ("map", "seen", "track", "step", "right", "unknown", *USED)
TOGETHER = (1, 3, 6)
"""Views in succession to which the model is fitted."""
RIDGE = 2e-4
LEAST_MISLEADING = 0.002
"""Share of views of what the worlds lack, as of a truck that stands before the sensor; by hand."""
SHARES = (1, 5, 50, 95, 99)
KEPT = Path(__file__).with_name("known-rows.npz")
"""Rows to which the shipped model was fitted."""
Row = tuple[float, ...]
Mask = NDArray[np.bool_]


def rows_of(world: World, config: Config) -> Float64:
    """Follow the drives of a world, at right and at wrong poses, (N, K)."""
    rows: list[Row] = []
    for m, name in enumerate(SEARCHED):
        localizer = Localizer(world.maps[name], config)
        for n, (scans, truths) in enumerate(world.drives()):
            for way in (WHOLE, NARROW, CROWDED):
                seen = [_seen(scan, k, way) for k, scan in enumerate(scans)]
                rows += ((m, way, *row) for row in _followed(localizer, seen, truths, n))
    return np.array(rows, np.float64).reshape(-1, len(COLUMNS))


def _seen(scan: Scan, number: int, way: int) -> Scan:
    points = scan.points
    if way == NARROW:
        points = narrowed(points, number)
    if way == CROWDED and number % CROWD == 0:
        points = crowded(points, number)
    return Scan(points, T_odom_sensor=scan.T_odom_sensor)


def crowded(points: Float32, seed: int) -> Float32:
    """Let people stand around the sensor: rays in some directions end at them."""
    rng = np.random.default_rng([seed, len(points)])
    sector = (np.arctan2(points[:, 1], points[:, 0]) * 18 / np.pi).astype(int) + 18
    blocked = rng.random(37) < rng.uniform(*CROWD_SHARE)
    away = rng.uniform(*CROWD_M, 37)[sector]
    reach = np.linalg.norm(points, axis=1)
    shorter = np.where(blocked[sector] & (reach > away), away / np.maximum(reach, 1e-6), 1.0)
    return np.asarray(points * shorter[:, None], np.float32)


def _followed(
    localizer: Localizer, scans: list[Scan], truths: Float64, drive: int
) -> Iterator[Row]:
    """Yield the track, the step, the label, the unknown share and the features of comparisons."""
    held: list[Pose] = []
    before: Pose | None = None
    for i, (scan, truth) in enumerate(zip(scans, truths, strict=True)):
        cloud, T_odom_sensor = localizer.accumulator.gather(scan), scan.T_odom_sensor
        assert T_odom_sensor is not None
        T_local_sensor = cloud.T_local_sensor
        if i % EVERY == 0:
            query = localizer.describe(cloud)
            places = localizer.search(query).posterior.places
            found = (place.T_map_local @ T_local_sensor for place in places)
            held = [T for T in found if not is_right(*errors(T, truth))][:HELD]
        elif before is not None:
            moved = geometry.inverse(before) @ T_odom_sensor
            held = [T @ moved for T in held]
        before, step = T_odom_sensor, i % EVERY
        at = _compared(localizer, cloud, truth)
        if at is not None:
            yield 1000 * drive, i, 1, at.unknown, *_used(at)
        for k, T in enumerate(held):
            at = _compared(localizer, cloud, T)
            if at is None:
                continue
            held[k] = T_there = at.T_map_local @ T_local_sensor
            number = 1000 * drive + i // EVERY * HELD + k + 1
            yield number, step, bool(is_right(*errors(T_there, truth))), at.unknown, *_used(at)


def _compared(localizer: Localizer, cloud: LocalCloud, T_map_sensor: Pose) -> ScoredPose | None:
    """Compare a cloud at a known pose; None if it has nothing to compare."""
    T = T_map_sensor @ geometry.inverse(cloud.T_local_sensor)
    return localizer.compare(cloud, [T]).at(T, localizer.likelihood.separation)


def _used(at: ScoredPose) -> Row:
    named = by_name(at.features)
    return tuple(named[name] for name in USED)


@dataclass(frozen=True)
class Views:
    """Comparisons of views, those of a robot one after another.

    Attributes
    ----------
    features : (N, K) float64
        Those of :data:`USED`.
    unknown : (N,) float64
    right : (N,) bool
    seen, robot, step : (N,)
        Way of seeing, number of the robot, and of the view on its way.
    world : (N,) int64
    kinds : sequence of str
        Kind of each world.
    """

    features: Float64
    unknown: Float64
    right: Mask
    seen: Int64
    robot: Int64
    step: Int64
    world: Int64
    kinds: Sequence[str]

    @classmethod
    def of(cls, worlds: dict[str, Float64]) -> Views:
        """Join the rows of worlds."""
        rows = np.concatenate(list(worlds.values()))
        world = np.repeat(np.arange(len(worlds)), [len(each) for each in worlds.values()])
        keys = np.column_stack([world, rows[:, :3]])
        robot = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        order = np.lexsort((rows[:, 3], robot))
        rows, world, robot = rows[order], world[order], robot[order]
        seen, step = rows[:, 1].astype(np.int64), rows[:, 3].astype(np.int64)
        kinds = [kind_of(name) for name in worlds]
        return cls(rows[:, 6:], rows[:, 5], rows[:, 4] > 0, seen, robot, step, world, kinds)

    def together(self, count: int) -> Int64:
        """Return the rows of so many views in succession, all right or all wrong, (M, count)."""
        every = np.arange(len(self.robot) - count + 1)[:, None] + np.arange(count)
        first, last = every[:, 0], every[:, -1]
        goes_on = self.robot[first] == self.robot[last]
        goes_on &= self.step[last] - self.step[first] == count - 1
        same = (self.right[every] == self.right[first][:, None]).all(axis=1)
        found: Int64 = every[goes_on & same]
        return found

    def evidence(self, known: Known) -> Float64:
        """Compute what each view says, (N,)."""
        named = [dict(zip(USED, row, strict=True)) for row in self.features.tolist()]
        rows = zip(named, self.unknown.tolist(), strict=True)
        return np.array([known.evidence(features, unknown) for features, unknown in rows])

    def told(self, known: Known) -> Float64:
        """Compute how much each view can say, (N,)."""
        return np.array([known.information(unknown) for unknown in self.unknown.tolist()])


def said_together(said: Float64, told: Float64, alike: float) -> Float64:
    """Add up what views say in succession, (M, count), as a tracker does, (M,)."""
    total = before = said[:, 0]
    for now, could in zip(said[:, 1:].T, told[:, 1:].T, strict=True):
        total = total + (now - could * alike * before) / (1.0 + alike)
        before = now + (1.0 - could) * alike * before
    return total


def fitted(views: Views, chosen: Mask) -> Known:
    """Fit the model to the views of some worlds."""
    X = np.column_stack([np.ones(len(views.robot)), views.features])
    runs = [run[chosen[views.world[run[:, 0]]]] for run in map(views.together, TOGETHER)]

    def loss(p: Float64) -> float:
        misleading, alike = 0.5 * expit(p[-3]), expit(p[-1])
        share = misleading + (1.0 - 2.0 * misleading) * expit(X @ p[: X.shape[1]])
        told = 1.0 - views.unknown ** np.exp(p[-2])
        said = told * logit(share)
        total = RIDGE * float((p[1 : X.shape[1]] ** 2).sum())
        for run in runs:
            right, sums = views.right[run[:, 0]], said_together(said[run], told[run], alike)
            total += float(np.logaddexp(0.0, -sums[right]).mean())
            total += float(np.logaddexp(0.0, sums[~right]).mean())
        return total

    start = np.concatenate([[-1.0], np.ones(len(USED)), [-4.0, 1.0, 1.0]])
    found = minimize(loss, start, method="BFGS", options={"gtol": 1e-4}).x
    constant, *weights = (round(float(w), 3) for w in found[: X.shape[1]])
    return Known(
        weights=dict(zip(USED, weights, strict=True)),
        constant=constant,
        misleading=round(max(float(0.5 * expit(found[-3])), LEAST_MISLEADING), 5),
        power=round(float(np.exp(found[-2])), 2),
        alike_m=round(-STEP_M / float(np.log(expit(found[-1]))), 1),
    )


def held_out(views: Views) -> Float64:
    """Compute what each view says by a fit to other worlds, (N,)."""
    said = np.empty(len(views.robot))
    for half in range(2):
        here = np.arange(len(views.kinds)) // 7 % 2 == half
        chosen = here[views.world]
        said[chosen] = views.evidence(fitted(views, ~here))[chosen]
    return said


def table(views: Views, said: Float64, known: Known) -> Table:
    """Show what views say together at right and at wrong poses, by kind and way of seeing."""
    kinds, told = np.array(views.kinds)[views.world], views.told(known)
    parts = {name: (kinds == name) & (views.seen == WHOLE) for name in dict.fromkeys(views.kinds)}
    ways = {"whole views": WHOLE, "narrow views": NARROW, "crowded": CROWDED}
    parts |= {name: views.seen == way for name, way in ways.items()}
    rows = list[tuple[Cell, ...]]()
    for name, part in parts.items():
        for count in TOGETHER:
            runs = views.together(count)
            runs = runs[part[runs[:, 0]]]
            right = views.right[runs[:, 0]]
            sums = said_together(said[runs], told[runs], known.alike(STEP_M))
            for label, here in (("right", right), ("wrong", ~right)):
                spread = np.percentile(sums[here], SHARES).round(1) if here.any() else []
                cells = (*(float(v) for v in spread), *[None] * (len(SHARES) - len(spread)))
                rows.append((name, count, label, int(here.sum()), *cells))
    columns = ("views", "together", "pose", "n", *(f"{share} %" for share in SHARES))
    note = "Each half of the worlds by a fit to the other."
    return Table(columns, rows, note, "Evidence at right and at wrong poses")


def read(path: Path) -> dict[str, Float64]:
    """Read the rows of worlds, by seed."""
    with np.load(path) as kept:
        return {n: kept[n].astype(np.float64) for n in sorted(kept, key=lambda n: seed_of(Path(n)))}


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--worlds", type=Path, help="folder of generated worlds, to collect rows")
    options.add_argument("--every", type=int, default=1, help="take each Nth world")
    options.add_argument("--workers", type=int, default=1, help="processes")
    options.add_argument("--rows", type=Path, default=KEPT, help="file of the rows")
    options.add_argument(
        "--out", type=Path, nargs="+", default=[], help="files of models, in which it is replaced"
    )
    args = options.parse_args()
    if args.worlds is not None:
        chosen = worlds_of(args.worlds)[:: args.every]
        found = in_parallel(partial(rows_of, config=Config(threads=1)), chosen, args.workers)
        rows = {chosen[k].name: each for k, each in track(found, "worlds", total=len(chosen))}
        small = {name: np.float32(each.round(2)) for name, each in rows.items()}
        np.savez_compressed(args.rows, **small)
    worlds = read(args.rows)
    views = Views.of(worlds)
    known = fitted(views, np.ones(len(worlds), bool))
    weights = Table(("", "value"), [("constant", known.constant), *known.weights.items()])
    evidence = table(views, held_out(views), known)
    publish(args.report, "What a view says of a known pose", evidence, weights)
    for path in args.out:
        model = json.loads(path.read_text("utf-8"))
        model["known"] = known.model_dump()
        seeds = [seed_of(Path(name)) for name in worlds]
        model["card"]["known"] = {
            "command": command(),
            "data": f"{len(worlds)} of the worlds (seeds {seeds[0]} to {seeds[-1]}), "
            f"{len(views.robot)} comparisons",
        }
        path.write_text(json.dumps(model, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main()
