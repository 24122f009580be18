r"""Fit the confidence of a pose on simulated worlds, and show how reliable it is.

Every scene is mapped by one sensor in one session and driven by several in another, in autumn and
with a fifth of the things replaced. Queries of these are localized in the map alone and padded with
the world before. The same queries in the mirror image of that map and in the map of the world
before are negatives; so are real recordings in every simulated map and in the mirror image of their
own. Each query is made with accumulated scans and with a single one, every second of them thinned,
the gates of verification open, so that the best candidate is always refined. A logistic model
(``segloc.verification.confidence``) is then fitted to the candidates' features -> right or wrong.
The figure shows each world judged by the model that was fitted to all the others.

    python -m segloc_experiments.calibration.confidence --real DATA/keyframes=DATA/keyframes.tum \
      DATA/scans=DATA/scans.tum --figure docs/images/reliability.svg
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.batch.negative_maps import mirrored
from segloc.batch.run import query_positions
from segloc.datasets import Sequence, open_sequence
from segloc.local_cloud import window
from segloc.simulation import SCENES, SENSORS, Conditions, SimulatedSequence, simulate_sessions
from segloc.verification import shipped_confidence
from segloc.verification.confidence import FEATURES

from ..padding import padded
from ..script import parser

EVERY_M = 10.0
ELSEWHERE_EVERY_M = 20.0
PADDED = 60_000
SPARSE = 6_400
LENGTH_M = 160.0
REAL_EVERY_M = 400.0
MAPPED_BY = "hdl64e"
SIZE_M = {"town": 200.0, "industrial": 200.0, "park": 200.0, "meadow": 200.0, "forest": 150.0}
OPEN = {
    "min_inliers": 2,
    "min_overlap": 0.0,
    "min_confidence": 0.0,
    "rival_support_ratio": 1e9,
    "rival_overlap_ratio": 1.0,
}
LATER = Conditions(foliage=0.6, replaced=0.2)
RIGHT_M = 1.0
COLUMNS = (
    "seen, logit",
    "inliers, log-likelihood over a rival's",
    "overlap, logit over a rival's",
    "seen, logit over a rival's",
    "inliers",
)
INLIERS, RIGHT, WORLD = 4, 5, 6
Row = tuple[float, ...]
BINS = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0 + 1e-9)


@dataclass(frozen=True)
class SimulatedWorld:
    """A session to map, and others, by several sensors, to localize."""

    name: str
    mapped: SimulatedSequence
    queries: dict[str, SimulatedSequence]


def worlds(sensors: list[str], first_seed: int, each: int) -> Iterator[SimulatedWorld]:
    """So many worlds of every scene."""
    seeds = count(first_seed)
    for name, scene in list(SCENES.items()) * each:
        seed = next(seeds)
        world = scene(seed, size_m=SIZE_M[name])
        drives = {
            sensor: simulate_sessions(
                world, SENSORS[sensor](900), [Conditions(), LATER], length_m=LENGTH_M, seed=seed
            )
            for sensor in {MAPPED_BY, *sensors}
        }
        queries = {sensor: drives[sensor][1] for sensor in sensors}
        yield SimulatedWorld(f"{name} {seed}", drives[MAPPED_BY][0], queries)


def thinned(scan: Scan, seed: int) -> Scan:
    """A scan of at most so many points, as slow links and small memories leave of it."""
    points = scan.points
    if len(points) > SPARSE:
        points = points[np.random.default_rng(seed).choice(len(points), SPARSE, replace=False)]
    return Scan(points, stamp=scan.stamp)


def candidates(localizer: Localizer, drive: Sequence, known: bool, every_m: float) -> list[Row]:
    """Rows (features, inliers, right) of queries along a drive."""
    local = localizer.config.local_cloud
    poses = drive.poses
    assert poses is not None
    rows: list[Row] = []
    for n, i in enumerate(query_positions(poses, every_m, local.max_gap_m)):
        behind = window(poses, i, local.window_m, centred=False, max_gap_m=local.max_gap_m)
        single = thinned(drive.scan(i), n) if n % 2 else drive.scan(i)
        for scans in ([drive.scan(k) for k in behind], single):
            query = localizer.describe(scans)
            evidence = localizer.search(query).verdict.evidence
            if evidence is None:
                continue
            best, T_local_sensor = evidence.score, query.cloud.T_local_sensor
            delta = geometry.inverse(poses[i]) @ best.T_map_local @ T_local_sensor
            right = known and np.linalg.norm(delta[:3, 3]) < RIGHT_M
            features = shipped_confidence().features(evidence)
            rows.append((*features, float(best.inliers), float(right)))
    return rows


class Calibration:
    """Gathers rows (features, inliers, right, world); they are kept in ``out``."""

    def __init__(self, out: Path) -> None:
        self.config = Config.preset("profile")
        gates = self.config.verification.model_copy(update=OPEN)
        self._opened = self.config.model_copy(update={"verification": gates, "threads": 1})
        self._out = out
        self.rows: list[Row] = []
        self._names: list[str] = []

    def localizer(self, prior_map: SegmentMap) -> Localizer:
        return Localizer(prior_map, self._opened)

    def add(self, name: str, rows: list[Row]) -> None:
        self.rows += [(*row, float(len(self._names))) for row in rows]
        self._names.append(name)
        np.savez(self._out, rows=np.array(self.rows), names=np.array(self._names))
        print(
            f"{name}: {len(rows)} candidates, {sum(r[RIGHT] > 0 for r in rows)} right", flush=True
        )

    def real(self, recording: Sequence) -> None:
        """A recording in the mirror image of its own map."""
        mirrored_place = self.localizer(mirrored(build_map(recording, self.config)))
        self.add(
            f"{recording.name}, mirrored",
            candidates(mirrored_place, recording, False, ELSEWHERE_EVERY_M),
        )

    def world(
        self, world: SimulatedWorld, before: SegmentMap | None, real: list[Sequence]
    ) -> SegmentMap:
        """All drives of a world in its map, in its mirror image, and in another world's map."""
        prior_map = build_map(world.mapped, self.config)
        here, elsewhere = [self.localizer(prior_map)], [self.localizer(mirrored(prior_map))]
        if before is not None:
            here.append(self.localizer(padded(prior_map, [before], PADDED)))
            elsewhere.append(self.localizer(before))
        rows: list[Row] = []
        for drive in world.queries.values():
            for place in here:
                rows += candidates(place, drive, True, EVERY_M)
            for other in elsewhere:
                rows += candidates(other, drive, False, ELSEWHERE_EVERY_M)
        for recording in real:
            rows += candidates(here[0], recording, False, REAL_EVERY_M)
        self.add(world.name, rows)
        return prior_map


def fit(rows: np.ndarray) -> np.ndarray:
    """The constant and the weights of a logistic model of the features.

    The penalty keeps it modest: right and wrong poses are nearly separable, which alone would make
    a fit as sure as its data are many.
    """
    features = _features(rows)
    sign = np.where(rows[:, RIGHT] > 0, 1.0, -1.0)

    def loss(w: np.ndarray) -> float:
        return float(np.logaddexp(0, -sign * (features @ w)).sum() + (w[1:] ** 2).sum())

    return np.asarray(minimize(loss, np.zeros(features.shape[1]), method="BFGS").x)


def _features(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones(len(rows)), rows[:, :INLIERS]])


def probability(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """What a model says of candidates."""
    p: np.ndarray = 1.0 / (1.0 + np.exp(-(_features(rows) @ weights)))
    return p


def held_out(rows: np.ndarray) -> np.ndarray:
    """The probability of every candidate by the model fitted to all other worlds."""
    p = np.empty(len(rows))
    for world in np.unique(rows[:, WORLD]):
        here = rows[:, WORLD] == world
        p[here] = probability(rows[here], fit(rows[~here]))
    return p


def report(rows: np.ndarray, weights: np.ndarray, p: np.ndarray) -> None:
    """Reliability in bins of confidence, and the gap between right and wrong."""
    right = rows[:, RIGHT] > 0
    print(f"{len(rows)} candidates, {int(right.sum())} right; weights {np.round(weights, 2)}")
    print("| confidence, model of the other worlds | candidates | right |\n|---|---|---|")
    for low, high in pairwise(BINS):
        chosen = (p >= low) & (p < high)
        if chosen.any():
            high = min(high, 1.0)
            print(f"| {low:.2f} to {high:.2f} | {chosen.sum()} | {right[chosen].mean():.3f} |")
    for name, q in (
        ("model of the other worlds", p),
        ("model of the package", probability(rows, _shipped())),
    ):
        brier, falsely = float(((q - right) ** 2).mean()), int((q[~right] > 0.5).sum())
        print(
            f"model of {name}: Brier score {brier:.4f}; confident (over 0.5) and wrong: {falsely}"
        )
    for name, part in (("right", rows[right]), ("wrong", rows[~right])):
        for column, label in enumerate(COLUMNS):
            q = np.nanpercentile(part[:, column], [0, 1, 50, 99, 100])
            print(f"  {name} {label}: " + " ".join(f"{v:.2f}" for v in q))


def _shipped() -> np.ndarray:
    """The constant and the weights of the model that comes with the package."""
    model = shipped_confidence()
    return np.array([model.constant, *(model.weights[name] for name in FEATURES)])


def joined(runs: list[np.ndarray]) -> np.ndarray:
    """The rows of several runs, each of worlds of its own."""
    for before, run in pairwise(runs):
        run[:, WORLD] += before[-1, WORLD] + 1
    return np.concatenate(runs)


def draw(rows: np.ndarray, p: np.ndarray, path: Path) -> None:
    """The reliability diagram, and how many candidates each bin holds."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    right = rows[:, RIGHT] > 0
    figure = Figure(figsize=(5.2, 4.2), facecolor="white")
    FigureCanvasSVG(figure)
    axes, below = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    axes.plot([0, 1], [0, 1], color="#7d8aa0", lw=1, ls="--")
    for low, high in pairwise(BINS):
        chosen = (p >= low) & (p < high)
        if chosen.any():
            n, k = int(chosen.sum()), int(right[chosen].sum())
            share, spread = k / n, 1.96 * np.sqrt((k + 1) * (n - k + 1) / (n + 2) ** 2 / (n + 3))
            axes.errorbar(p[chosen].mean(), share, spread, fmt="o", color="#12a150", capsize=3)
    axes.set_ylabel("share right")
    axes.set_ylim(-0.05, 1.05)
    below.hist([p[right], p[~right]], bins=20, color=["#12a150", "#e5243b"], log=True)
    below.legend(["right", "wrong"], fontsize=8, frameon=False)
    below.set_xlabel("confidence, by the model of the other worlds")
    below.set_ylabel("candidates")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--sensors", nargs="*", default=["hdl64e", "os1-64", "vlp16"])
    options.add_argument("--each", type=int, default=2, help="worlds of every scene")
    options.add_argument("--real", nargs="*", default=[], metavar="SCANS=POSES")
    options.add_argument("--first-seed", type=int, default=3000)
    options.add_argument("--out", type=Path, default=Path("calibration.npz"))
    options.add_argument("--rows", nargs="+", type=Path, help="rows of earlier runs")
    options.add_argument("--figure", type=Path)
    args = options.parse_args()
    if args.rows is None:
        real = [open_sequence(*pair.split("=")) for pair in args.real]
        calibration, before = Calibration(args.out), None
        for recording in real:
            calibration.real(recording)
        for world in worlds(args.sensors, args.first_seed, args.each):
            before = calibration.world(world, before, real)
        rows = np.array(calibration.rows)
    else:
        rows = joined([np.load(path)["rows"] for path in args.rows])
    p = held_out(rows)
    report(rows, fit(rows), p)
    if args.figure is not None:
        draw(rows, p, args.figure)


if __name__ == "__main__":
    main()
