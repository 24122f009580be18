"""Fit the posterior to rows of simulated worlds, and report what it finds and how reliable it is.

For each query in each map (:mod:`.rows`) the classes are the distinct poses that were measured, and
"not in this map": a conditional logit of :data:`segloc.likelihood.FEATURES` with a ridge, which is
convex. All tables show worlds judged by a fit to other worlds. False answers come in clumps, a
world at a time, so worlds are counted beside queries. Real recordings take no part.

    python -m segloc_lab.calibration.posterior ROWS... --out src/segloc/weights/posterior.json
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.optimize import minimize
from scipy.special import expit, logsumexp

from segloc.likelihood import Count, shipped_model
from segloc.likelihood.model import FEATURES, FREE
from segloc.types import Float32, Float64, Int64

from ..report import Cell, Table, command, publish, reporting, share, wilson
from .rows import HOME, MAPS, MEASURES, Rows
from .worlds import KINDS

RIGHT_M, RIGHT_DEG = 2.0, 10.0
"""Error below which a pose is right [m, deg]."""
RIDGE = 0.2
"""Penalty on the squares of the weights: classes are nearly separable, which alone would make a
fit as certain as its data are many."""
FOLDS = 12
MARGIN = 1.0
"""Log-odds by which the threshold exceeds that of the worst false answer."""
FALSE_AT = (0, 1, 3, 10)
"""Numbers of false answers at which answers found are counted."""
BINS = (0.5, 0.9, 0.99, 0.999, 1.0)
ALIKE = ("offices", "warehouse")
"""Kinds of worlds whose parts repeat."""
_COLUMN = {name: k for k, name in enumerate(MEASURES)}
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Fit:
    """A measured pose as the model reads it; ``intruding`` is None where it was not measured."""

    inliers: int
    overlap: float
    seen: Count
    ground: Count
    flush: Count
    intruding: Count | None

    @classmethod
    def of(cls, row: Float32) -> Fit:
        """Read a row of measures."""
        seen, ground, flush, intruding = (
            Count(*np.nan_to_num(row[[_COLUMN[hits], _COLUMN[of]]]).astype(int).tolist())
            for hits, of in (
                ("seen", "in_view"),
                ("ground", "ground_of"),
                ("flush", "flush_of"),
                ("intruding", "standing"),
            )
        )
        inliers, overlap = int(row[_COLUMN["inliers"]]), float(row[_COLUMN["overlap"]])
        known = bool(np.isfinite(row[_COLUMN["standing"]]))
        return cls(inliers, overlap, seen, ground, flush, intruding if known else None)

    def has(self, name: str) -> bool:
        """Return whether a measure is known."""
        return getattr(self, name) is not None


@dataclass(frozen=True)
class Records:
    """Queries in maps, with at most M measured poses each.

    Attributes
    ----------
    features : (R, M, K) float64
        Zero where there is no pose.
    poses, right, false : (R, M) bool
        Whether there is a pose, whether it is right, and whether it would be a false answer.
    world, kind, place : (R,)
        Number and kind of the world, name of the map.
    """

    features: Float64
    poses: Mask
    right: Mask
    false: Mask
    world: Int64
    kind: NDArray[np.str_]
    place: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.world)

    def __getitem__(self, chosen: Mask) -> Records:
        names = ("features", "poses", "right", "false", "world", "kind", "place")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def found_at(self) -> Int64:
        """The right pose of each record; M where there is none, (R,)."""
        most = self.right.shape[1]
        first: Int64 = self.right.argmax(axis=1)
        return np.where(self.right.any(axis=1), first, most)


def records_of(rows: Rows) -> Records:
    """Compute the features of all poses, query by query."""
    count, most = len(rows), int(np.diff(rows.spans).max(initial=1))
    features = np.zeros((count, most, len(FEATURES)))
    poses, right, false = (np.zeros((count, most), bool) for _ in range(3))
    for k, (first, end) in enumerate(track(rows.spans, "features")):
        fits, n = rows.fits[first:end], end - first
        features[k, :n] = described(fits)
        error, turned = fits[:, _COLUMN["error_m"]], fits[:, _COLUMN["error_deg"]]
        near = (error < RIGHT_M) & (rows.place[k] in HOME)
        poses[k, :n], right[k, :n], false[k, :n] = True, near & (turned < RIGHT_DEG), ~near
    names = {name: k for k, name in enumerate(dict.fromkeys(rows.world))}
    world = np.array([names[name] for name in rows.world])
    kind = np.array([name.rsplit("-", 1)[0] for name in rows.world])
    return Records(features, poses, right, false, world, kind, rows.place)


def described(rows: Float32) -> Float64:
    """Compute the features of the poses of one query in one map, (N, K)."""
    model, fits = shipped_model(), [Fit.of(row) for row in rows]
    elsewhere = rows[:, _COLUMN["elsewhere"]]
    features = [
        model.features(fit, [f for f in fits if f is not fit], int(most), FREE)  # type: ignore
        for fit, most in zip(fits, elsewhere, strict=True)
    ]
    return np.array(features, np.float64).reshape(-1, len(FEATURES))


def fit(records: Records, start: Float64 | None = None) -> Float64:
    """Fit the weights and, last, the score of "not in this map", (K + 1,)."""
    target = records.found_at
    rows, most = np.arange(len(records)), records.poses.shape[1]
    chosen = np.zeros((len(records), most + 1))
    chosen[rows, target] = 1.0

    def loss(w: Float64) -> tuple[float, Float64]:
        scores = _scores(records, w)
        total = logsumexp(scores, axis=1)
        excess = np.exp(scores - total[:, None]) - chosen
        slope = np.einsum("rm,rmk->k", excess[:, :most], records.features)
        modest = np.append(w[:-1], 0.0)
        value = float((total - scores[rows, target]).sum() + RIDGE * (modest**2).sum())
        return value, np.append(slope, excess[:, most].sum()) + 2 * RIDGE * modest

    start = np.zeros(len(FEATURES) + 1) if start is None else start
    return np.asarray(minimize(loss, start, jac=True, method="BFGS", options={"gtol": 1e-3}).x)


def _scores(records: Records, weights: Float64) -> Float64:
    """Compute the scores of the poses and, last, of "not in this map", (R, M + 1)."""
    scores = np.where(records.poses, records.features @ weights[:-1], -np.inf)
    return np.column_stack([scores, np.full(len(records), weights[-1])])


@dataclass(frozen=True)
class Judged:
    """The likeliest pose of each record: its log-odds, and whether it is right or false."""

    log_odds: Float64
    right: Mask
    false: Mask

    @classmethod
    def by(cls, records: Records, weights: Float64) -> Judged:
        """Judge records by a fit."""
        scores, rows = _scores(records, weights), np.arange(len(records))
        best = scores[:, :-1].argmax(axis=1)
        most = scores[rows, best]
        scores[rows, best] = -np.inf
        log_odds = most - logsumexp(scores, axis=1)
        exists = records.poses[rows, best]
        return cls(log_odds, records.right[rows, best], records.false[rows, best] & exists)

    def threshold(self, false: int) -> float:
        """Return the log-odds above which so many answers are false."""
        worst = np.sort(self.log_odds[self.false])[::-1]
        return float(worst[false]) if false < len(worst) else -np.inf

    def found(self, threshold: float, chosen: Mask | bool = True) -> int:
        """Count the right answers above a threshold."""
        return int((self.right & (self.log_odds > threshold) & chosen).sum())


def held_out(records: Records, groups: NDArray[Any]) -> Judged:
    """Judge each group of records by a fit to all others."""
    log_odds = np.full(len(records), -np.inf)
    right, false = np.zeros((2, len(records)), bool)
    weights = None
    for group in track(np.unique(groups), "held out"):
        here = groups == group
        weights = fit(records[~here], weights)
        part = Judged.by(records[here], weights)
        log_odds[here], right[here], false[here] = part.log_odds, part.right, part.false
    return Judged(log_odds, right, false)


def folds(records: Records) -> Int64:
    """Number the folds: whole worlds, each fold of all kinds."""
    return records.world // len(KINDS) % FOLDS


def found_table(records: Records, runs: dict[str, Judged]) -> Table:
    """Count what is found at a few false answers, of each kind of world."""
    rows: list[tuple[Cell, ...]] = []
    for name, judged in runs.items():
        limits = [judged.threshold(count) for count in FALSE_AT]
        for kind in (*KINDS, "all"):
            here = (records.kind == kind) | (kind == "all")
            possible = int((records.right.any(axis=1) & here).sum())
            rows.append((name, kind, possible, *(judged.found(t, here) for t in limits)))
        rows.append((name, "log-odds", None, *(round(t, 2) for t in limits)))
    columns = ("held out", "kind", "right pose", *(f"found at {n} false" for n in FALSE_AT))
    return Table(columns, rows, title="Found, by the number of false answers")


def false_table(records: Records, judged: Judged, threshold: float) -> Table:
    """Count answers above a threshold by map: found, false, and worlds with a false one."""
    rows = [
        _false_row(name, records, judged, threshold, here)
        for name, here in (
            *((name, records.place == name) for name in MAPS),
            *((name, records.kind == name) for name in KINDS),
            ("all", np.ones(len(records), bool)),
        )
    ]
    columns = ("map or kind", "records", "found", "false", "at most", "worlds", "at most of them")
    note = f"Log-odds above {threshold:.2f}. At most: upper ends of Wilson's 95 % intervals."
    return Table(columns, rows, note, "False answers")


def _false_row(
    name: str, records: Records, judged: Judged, threshold: float, here: Mask
) -> tuple[Cell, ...]:
    false = judged.false & (judged.log_odds > threshold) & here
    count, worlds = int(false.sum()), len(np.unique(records.world[here]))
    spoilt = len(np.unique(records.world[false]))
    return (
        name,
        int(here.sum()),
        judged.found(threshold, here),
        count,
        f"{100 * wilson(count, int(here.sum()))[1]:.3f} %",
        f"{spoilt} of {worlds}",
        f"{100 * wilson(spoilt, worlds)[1]:.1f} %",
    )


def reliability_table(records: Records, judged: Judged) -> Table:
    """Compare probabilities with shares of wrong answers."""
    p, alike = expit(judged.log_odds), np.isin(records.kind, ALIKE)
    rows = [
        (name, f"{low:g} to {high:g}", *_bin(p, judged, chosen & (p >= low) & (p < high)))
        for name, chosen in (("all", np.ones(len(p), bool)), ("repeating", alike))
        for low, high in pairwise((*BINS[:-1], 1.0 + 1e-9))
    ]
    columns = ("kinds", "probability", "wrong", "expected wrong")
    return Table(columns, rows, f"Repeating: {', '.join(ALIKE)}.", "Reliability")


def _bin(p: Float64, judged: Judged, here: Mask) -> Iterator[Cell]:
    yield share(int((~judged.right & here).sum()), int(here.sum()))
    yield round(float((1.0 - p[here]).sum()), 2)


def card(records: Records, judged: Judged, threshold: float, rows: Rows) -> dict[str, Any]:
    """Describe the data, the command and the figures of a fit."""
    false = judged.false & (judged.log_odds > threshold)
    possible = int(records.right.any(axis=1).sum())
    worlds = set(rows.world.tolist())
    seeds = sorted(int(name.rsplit("-", 1)[1]) for name in worlds)
    return {
        "what": "Linear log-ratio of a pose against 'not in this map': a conditional logit",
        "command": command(),
        "data": f"{len(worlds)} simulated worlds of {len(KINDS)} kinds (seeds {seeds[0]} to "
        f"{seeds[-1]}), {len(records)} queries in maps, {int(records.poses.sum())} poses. No real "
        "recording",
        "ridge": RIDGE,
        "figures": {
            "held_out_found": f"{judged.found(threshold)} of {possible}",
            "held_out_false": f"{int(false.sum())} of {len(records)}",
            "log_odds": round(threshold, 2),
        },
    }


def write(path: Path, weights: Float64, card: dict[str, Any]) -> None:
    """Replace the weights and the card in a file of the model."""
    model = json.loads(path.read_text("utf-8"))
    model["weights"] = {n: round(float(w), 3) for n, w in zip(FEATURES, weights, strict=False)}
    model["none"], model["card"] = round(float(weights[-1]), 3), card
    path.write_text(json.dumps(model, indent=1, ensure_ascii=False) + "\n", "utf-8")


def weights_table(weights: Float64, each: Iterable[Float64] = ()) -> Table:
    """List the weights."""
    rows = [(n, round(float(w), 3)) for n, w in zip((*FEATURES, "none"), weights, strict=True)]
    return Table(("feature", "weight"), rows, title="Weights")


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("rows", type=Path, nargs="+", help="files of rows")
    options.add_argument("--join", type=Path, help="file to keep all rows in")
    options.add_argument("--out", type=Path, help="file of the model whose weights are replaced")
    args = options.parse_args()
    paths = sorted(args.rows, key=lambda path: path.stem.rsplit("-", 1)[-1])
    rows = Rows.joined([Rows.load(path) for path in paths])
    if args.join is not None:
        rows.save(args.join)
    records = records_of(rows)
    runs = {"worlds": held_out(records, folds(records)), "kinds": held_out(records, records.kind)}
    threshold = max(run.threshold(0) for run in runs.values()) + MARGIN
    weights = fit(records)
    publish(
        args.report,
        "Fit of the posterior",
        found_table(records, runs),
        false_table(records, runs["worlds"], threshold),
        reliability_table(records, runs["worlds"]),
        weights_table(weights),
    )
    if args.out is not None:
        write(args.out, weights, card(records, runs["worlds"], threshold, rows))


if __name__ == "__main__":
    main()
