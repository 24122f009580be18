r"""Fit the posterior to rows of simulated worlds, and report what it finds and how reliable it is.

For each query in each map (:mod:`.rows`) the classes are the distinct poses that were measured, and
"not in this map": a conditional logit of :data:`segloc.likelihood.FEATURES` with a ridge, which is
convex. All tables show worlds evaluated by a fit to other worlds. False answers come in clumps, a
world at a time, so worlds are counted beside queries. Real recordings take no part.

The rows of the shipped weights are kept beside this module; ``--join`` made them of those of single
worlds.

    python -m segloc_lab.calibration.posterior --out src/segloc/weights/posterior.json \
        --figure docs/images/reliability.svg
    python -m segloc_lab.calibration.posterior --without-ground \
        --out src/segloc/weights/posterior-without-ground.json
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.optimize import minimize
from scipy.special import expit, logit, logsumexp

from segloc.likelihood import (
    FEATURES,
    Count,
    Evidence,
    Promise,
    VerificationConfig,
    features_of,
    shipped_model,
    terms_of,
)
from segloc.tools.inspect import GREEN, PATH, RED
from segloc.types import Float32, Float64, Int64

from ..report import Cell, Table, command, publish, reporting, share, wilson
from .rows import ALIGNED, BARE, HOME, MAPS, MEASURES, ROUGH, Rows, is_right
from .worlds import KINDS

RIDGE = 0.2
"""Penalty on the squares of the weights: classes are nearly separable, which alone would make a
fit as certain as its data are many."""
FOLDS = 12
KEPT = Path(__file__).with_name("posterior-rows.npz")
"""Rows to which the shipped weights were fitted."""
FALSE_AT = (0, 1, 3, 10)
"""Numbers of false answers at which answers found are counted."""
BINS = (0.5, 0.9, 0.99, 0.999, 1.0)
CONFIDENCES = (0.8, 0.9, 0.95, 0.99, 0.999)
ALIKE = ("offices", "warehouse")
"""Kinds of worlds whose parts repeat."""
_COLUMN = {name: k for k, name in enumerate(MEASURES)}
_BEFORE = [_COLUMN[name] for name in ROUGH + ALIGNED]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Fit:
    """A measured pose as the model reads it."""

    inliers: int
    known: Evidence
    seen: Count
    ground: Count
    on_surface: Count
    inside: Count
    planes: Count

    @classmethod
    def of(cls, row: list[float]) -> Fit:
        """Read a row of measures."""

        def counts(*names: str) -> list[int]:
            return [int(row[_COLUMN[name]]) for name in names]

        return cls(
            int(row[_COLUMN["inliers"]]),
            Evidence(*counts("known_on", "known_off", "known_of")),
            Count(*counts("seen", "in_view")),
            Count(*counts("ground", "ground_of")),
            Count(*counts("on_surface", "on_surface_of")),
            Count(*counts("inside", "inside_of")),
            Count(*counts("planes", "planes_of")),
        )


@dataclass(frozen=True)
class Records:
    """Queries in maps, with at most M measured poses each.

    Attributes
    ----------
    features : (R, M, K) float64
        What is weighed of :data:`segloc.likelihood.FEATURES` (:func:`segloc.likelihood.terms_of`);
        zero where there is no pose.
    before : (R, M, 5) float64
        What was known before the measurement: three numbers before alignment, two after.
    poses, right, false : (R, M) bool
        Whether there is a pose, whether it is right, and whether it would be a false answer.
    world, kind, place : (R,)
        Number and kind of the world, name of the map.
    """

    features: Float64
    before: Float64
    poses: Mask
    right: Mask
    false: Mask
    world: Int64
    kind: NDArray[np.str_]
    place: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.world)

    def __getitem__(self, chosen: Mask) -> Records:
        return replace(self, **{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @property
    def found_at(self) -> Int64:
        """The right pose of each record; M where there is none, (R,)."""
        most = self.right.shape[1]
        first: Int64 = self.right.argmax(axis=1)
        return np.where(self.right.any(axis=1), first, most)


def records_of(rows: Rows, *, ground: bool = True) -> Records:
    """Compute the features of all poses, query by query, as the model of such maps weighs them.

    Without ground, a map has no evidence in *ground* and *in view*: it is a finished cloud, which
    holds what nothing on the path saw.
    """
    walls_power = shipped_model(ground=ground).walls_power
    count, most = len(rows), int(np.diff(rows.spans).max(initial=1))
    features = np.zeros((count, most, len(FEATURES)))
    before = np.zeros((count, most, len(_BEFORE)))
    poses, right, false = (np.zeros((count, most), bool) for _ in range(3))
    for k, (first, end) in enumerate(track(rows.spans, "features")):
        fits, n = rows.fits[first:end], end - first
        features[k, :n], before[k, :n] = described(fits, walls_power), fits[:, _BEFORE]
        error, turned = fits[:, _COLUMN["error_m"]], fits[:, _COLUMN["error_deg"]]
        found = is_right(error, turned) & (rows.place[k] in HOME)
        poses[k, :n], right[k, :n], false[k, :n] = True, found, ~found
    if not ground:
        features[..., [FEATURES.index(name) for name in ("ground", "in_view")]] = 0.0
    names = {name: k for k, name in enumerate(dict.fromkeys(rows.world))}
    world = np.array([names[name] for name in rows.world])
    kind = np.array([name.rsplit("-", 1)[0] for name in rows.world])
    return Records(features, before, poses, right, false, world, kind, rows.place)


def described(rows: Float32, walls_power: float) -> Float64:
    """Compute the features of the poses of one query in one map, (N, K).

    Each is compared with the rival that overlaps most, as by a scorer.
    """
    found: list[tuple[float, ...]] = []
    rivals = rows[:, [_COLUMN[name] for name in ALIGNED]].tolist()
    by_overlap = sorted(range(len(rows)), key=lambda k: -rivals[k][0])[:2]
    for k, row in enumerate(rows.tolist()):
        others = [rivals[other] for other in by_overlap if other != k]
        elsewhere, walls = int(row[_COLUMN["elsewhere"]]), row[_COLUMN["walls"]]
        features = features_of(Fit.of(row), rivals[k][0], others, elsewhere, walls)
        found.append((*terms_of(features, walls_power).values(),))
    return np.array(found, np.float64).reshape(-1, len(FEATURES))


def fitted(records: Records, start: Float64 | None = None) -> tuple[Float64, dict[str, Promise]]:
    """Fit the weights, and what a place promises.

    The loss is convex: ``start`` changes the time, not the fit.
    """
    weights = fit(records, start)
    log_ratio = (records.features @ weights[:-1] - weights[-1])[records.poses]
    return weights, promises(records, log_ratio > 0.0)


def promises(records: Records, competes: Mask) -> dict[str, Promise]:
    """Fit what is known before the measurement to whether poses compete."""
    found = {}
    for name, count in (("rough", len(ROUGH)), ("aligned", len(ROUGH + ALIGNED))):
        weights = logistic_regression(_known(records.before, count)[records.poses], competes)
        found[name] = Promise(weights=tuple(round(float(w), 3) for w in weights))
    return found


def _known(before: Float64, count: int) -> Float64:
    """Return a constant and the first measures, (..., 1 + count)."""
    return np.concatenate([np.ones((*before.shape[:-1], 1)), before[..., :count]], axis=-1)


def logistic_regression(x: Float64, y: Mask) -> Float64:
    """Fit the log-odds of ``y`` to columns of which the first is constant."""
    scale = np.append(1.0, x[:, 1:].std(axis=0) + 1e-9)
    z = x / scale

    def loss(w: Float64) -> tuple[float, Float64]:
        score = z @ w
        value = np.logaddexp(0.0, score).sum() - score[y].sum() + RIDGE * (w[1:] ** 2).sum()
        return float(value), z.T @ (expit(score) - y) + 2 * RIDGE * np.append(0.0, w[1:])

    return np.asarray(minimize(loss, np.zeros(z.shape[1]), jac=True, method="L-BFGS-B").x / scale)


def fit(records: Records, start: Float64 | None = None) -> Float64:
    """Fit the weights and, last, the score of "not in this map", (K + 1,)."""
    records = records[told_apart(records)]
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
class Decisions:
    """The likeliest pose of each record: its log-odds, and whether it is right or false."""

    log_odds: Float64
    right: Mask
    false: Mask

    @classmethod
    def by(cls, records: Records, weights: Float64) -> Decisions:
        """Judge records by a fit."""
        scores, rows = _scores(records, weights), np.arange(len(records))
        best = scores[:, :-1].argmax(axis=1)
        most = scores[rows, best]
        scores[rows, best] = -np.inf
        log_odds = most - logsumexp(scores, axis=1)
        exists = records.poses[rows, best]
        return cls(log_odds, records.right[rows, best], records.false[rows, best] & exists)

    def __getitem__(self, chosen: Mask) -> Decisions:
        return Decisions(self.log_odds[chosen], self.right[chosen], self.false[chosen])

    def threshold(self, false: int) -> float:
        """Return the log-odds above which ``false`` answers are false."""
        worst = np.sort(self.log_odds[self.false])[::-1]
        return float(worst[false]) if false < len(worst) else -np.inf


def held_out(records: Records, groups: NDArray[Any]) -> Decisions:
    """Judge each group of records by a fit to all others."""
    log_odds = np.full(len(records), -np.inf)
    right, false = np.zeros((2, len(records)), bool)
    weights = None
    for group in track(np.unique(groups), "held out"):
        here = groups == group
        weights = fit(records[~here], weights)
        part = Decisions.by(records[here], weights)
        log_odds[here], right[here], false[here] = part.log_odds, part.right, part.false
    return Decisions(log_odds, right, false)


def told_apart(records: Records) -> Mask:
    """Return which records a view can decide: not where half a hall lacks what looks the same.

    The halves of halls are alike, so what fits one as well as the other teaches nothing.
    """
    alike = [name for name, kind in KINDS.items() if kind.alike]
    half_of_alike = np.isin(records.kind, alike) & (records.place == "half")
    decided: Mask = ~half_of_alike | records.right.any(axis=1)
    return decided


def folds(records: Records) -> Int64:
    """Number the folds: whole worlds, each fold of all kinds."""
    return records.world // len(KINDS) % FOLDS


def found_table(runs: dict[str, tuple[Records, Decisions]]) -> Table:
    """Count what is found at a few false answers, of each kind of world."""
    rows: list[tuple[Cell, ...]] = []
    for name, (records, decisions) in runs.items():
        limits = [decisions.threshold(count) for count in FALSE_AT]
        for kind in (*KINDS, "all"):
            here = (records.kind == kind) | (kind == "all")
            possible, right = records.right.any(axis=1) & here, decisions.right & here
            found = (int((right & (decisions.log_odds > limit)).sum()) for limit in limits)
            rows.append((name, kind, int(possible.sum()), *found))
        rows.append((name, "log-odds", None, *(round(limit, 2) for limit in limits)))
    columns = ("held out", "kind", "right pose", *(f"found at {n} false" for n in FALSE_AT))
    return Table(columns, rows, title="Found, by the number of false answers")


def confidence_table(runs: dict[str, tuple[Records, Decisions]]) -> Table:
    """Count what is found and false at a confidence, by query and by world."""
    rows = [
        (name, confidence, *_counted(records, decisions, logit(confidence)))
        for name, (records, decisions) in runs.items()
        for confidence in CONFIDENCES
    ]
    columns = ("held out", "confidence", *COUNTED)
    return Table(columns, rows, WILSON, "Answers, by the confidence needed")


def false_table(records: Records, decisions: Decisions, confidence: float) -> Table:
    """Count what is found and false at a confidence, of each map and kind of world."""
    parts = [(name, records.place == name) for name in (*MAPS, BARE)]
    parts += [(name, records.kind == name) for name in KINDS]
    limit = logit(confidence)
    rows = [(name, *_counted(records[here], decisions[here], limit)) for name, here in parts]
    title = f"Answers of confidence {confidence:g}, by map and kind"
    return Table(("map or kind", *COUNTED), rows, WILSON, title)


COUNTED = ("right pose", "found", "queries", "false", "at most", "worlds", "false in", "at most")
WILSON = "At most: upper ends of Wilson's 95 % intervals."


def _counted(records: Records, decisions: Decisions, limit: float) -> Iterator[Cell]:
    answered = decisions.log_odds > limit
    false = decisions.false & answered
    yield int(records.right.any(axis=1).sum())
    yield int((decisions.right & answered).sum())
    for all_of, bad in ((len(records), false.sum()), (_count(records), _count(records[false]))):
        yield all_of
        yield int(bad)
        yield f"{100 * wilson(int(bad), all_of)[1]:.2f} %"


def _count(records: Records) -> int:
    return len(np.unique(records.world))


def reliability_table(records: Records, decisions: Decisions) -> Table:
    """Compare probabilities with shares of wrong answers."""
    p, apart = expit(decisions.log_odds), told_apart(records)
    repeating = apart & np.isin(records.kind, ALIKE)
    parts = {"all": np.ones(len(p), bool), "told apart": apart, "repeating": repeating}
    rows = [
        (name, f"{low:g} to {high:g}", *_bin(p, decisions, chosen & (p >= low) & (p < high)))
        for name, chosen in parts.items()
        for low, high in pairwise((*BINS[:-1], 1.0 + 1e-9))
    ]
    columns = ("queries", "probability", "wrong", "expected wrong")
    return Table(
        columns, rows, f"Repeating: {', '.join(ALIKE)}, where views can tell.", "Reliability"
    )


def _bin(p: Float64, decisions: Decisions, here: Mask) -> Iterator[Cell]:
    yield share(int((~decisions.right & here).sum()), int(here.sum()))
    yield round(float((1.0 - p[here]).sum()), 2)


def draw(decisions: Decisions, path: Path) -> None:
    """Draw the reliability diagram, and how many answers each bin holds."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    p, right = expit(decisions.log_odds), decisions.right
    figure = Figure(figsize=(5.2, 4.2), facecolor="white")
    FigureCanvasSVG(figure)
    axes, below = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    axes.plot([0, 1], [0, 1], color=PATH, lw=1, ls="--")
    for low, high in pairwise(np.linspace(0.0, 1.0 + 1e-9, 11)):
        here = (p >= low) & (p < high)
        if here.any():
            hits, mean = int(right[here].sum()), float(right[here].mean())
            bounds = np.abs(np.array(wilson(hits, int(here.sum()))) - mean)[:, None]
            axes.errorbar(p[here].mean(), mean, bounds, fmt="o", color=GREEN, capsize=3)
    axes.set_ylabel("share right")
    axes.set_ylim(-0.05, 1.05)
    below.hist([p[right], p[~right]], bins=20, color=[GREEN, RED], log=True)
    below.legend(["right", "wrong"], fontsize=8, frameon=False)
    below.set_xlabel("probability of the likeliest pose, by a fit to other worlds")
    below.set_ylabel("answers")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})


def card(records: Records, decisions: Decisions, rows: Rows) -> dict[str, Any]:
    """Describe the data, the command and the figures of a fit."""
    worlds = set(rows.world.tolist())
    seeds = sorted(int(name.rsplit("-", 1)[1]) for name in worlds)
    found = {f"{c:g}": list(_counted(records, decisions, logit(c)))[1:4:2] for c in CONFIDENCES}
    return {
        "what": "Linear log-ratio of a pose against 'not in this map': a conditional logit",
        "command": command(),
        "rows": "python -m segloc_lab.calibration.worlds --first-seed 21000 --each 21 --out WORLDS"
        "; python -m segloc_lab.calibration.rows WORLDS --out ROWS",
        "data": f"{len(worlds)} simulated worlds of {len(KINDS)} kinds (seeds {seeds[0]} to "
        f"{seeds[-1]}), {len(records)} queries in maps, {int(records.right.any(axis=1).sum())} "
        f"with a right pose, {int(records.poses.sum())} poses. No real recording",
        "ridge": RIDGE,
        "held_out_found_and_false_by_confidence": found,
    }


def write(path: Path, weights: Float64, promised: dict[str, Promise], card: dict[str, Any]) -> None:
    """Replace the weights, the intervals and the card in a file of the model."""
    model = json.loads(path.read_text("utf-8"))
    model["weights"] = {n: round(float(w), 3) for n, w in zip(FEATURES, weights, strict=False)}
    model["none"], model["card"] = round(float(weights[-1]), 3), model["card"] | card
    model["settings"]["verification"] = VerificationConfig().model_dump(
        mode="json", exclude={"min_confidence"}
    )
    model |= {name: promise.model_dump() for name, promise in promised.items()}
    path.write_text(json.dumps(model, indent=1, ensure_ascii=False) + "\n", "utf-8")


def weights_table(weights: Float64) -> Table:
    """List the weights."""
    rows = [(n, round(float(w), 3)) for n, w in zip((*FEATURES, "none"), weights, strict=True)]
    return Table(("feature", "weight"), rows, title="Weights")


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("rows", type=Path, nargs="*", default=[KEPT], help="files of rows")
    options.add_argument("--join", type=Path, help="file to keep all rows in")
    options.add_argument(
        "--without-ground", action="store_true", help="drop all ground, as in maps without any"
    )
    options.add_argument("--figure", type=Path, help="SVG of the reliability")
    options.add_argument("--out", type=Path, help="file of the model whose weights are replaced")
    args = options.parse_args()
    paths = sorted(args.rows, key=lambda path: path.stem.rsplit("-", 1)[-1])
    rows = Rows.joined([Rows.load(path) for path in paths])
    if args.join is not None:
        rows.save(args.join)
    records = records_of(rows, ground=not args.without_ground)
    weights, promised = fitted(records)
    decisions = held_out(records, folds(records))
    apart = told_apart(records)
    runs = {
        "worlds": (records, decisions),
        "kinds": (records, held_out(records, records.kind)),
        "worlds, told apart": (records[apart], decisions[apart]),
    }
    publish(
        args.report,
        "Fit of the posterior",
        found_table(runs),
        confidence_table(runs),
        false_table(records, decisions, VerificationConfig().min_confidence),
        reliability_table(records, decisions),
        weights_table(weights),
    )
    if args.figure is not None:
        draw(decisions, args.figure)
    if args.out is not None:
        write(args.out, weights, promised, card(records, decisions, rows))


if __name__ == "__main__":
    main()
