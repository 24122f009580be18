"""How reliable a model of the confidence is: fitted, held out world by world, and drawn.

python -m segloc_lab.calibration.reliability --real FILE --simulated FILE [--report FOLDER]
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from segloc.inspect import GREEN, PATH, RED
from segloc.likelihood import (
    CAUTIOUS_FEATURES,
    CAUTIOUSLY,
    FEATURES,
    REPEATED_ROOT,
    VerificationConfig,
    shipped_confidence,
)

from ..report import Cell, Table, publish, reporting, share

COLUMNS = (*FEATURES, "root")
ROOT, EQUAL, RIGHT, WORLD = range(len(FEATURES), len(FEATURES) + 4)
"""Columns of a row: the features come first. ROOT: of the confidence that suffices, as much is
needed. EQUAL: whether a rival explains the query as well."""
LIKELY = 0.98
"""A pose that segments say little of is believed from here on, unless it is doubted."""
BINS = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0 + 1e-9)


def fit(rows: np.ndarray) -> np.ndarray:
    """The constant and the weights of a logistic model of the features.

    The penalty keeps it modest: right and wrong poses are nearly separable, which alone would make
    a fit as sure as its data are many.
    """
    features = _features(rows)
    sign = np.where(rows[:, RIGHT] > 0, 1.0, -1.0)

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        against, modest = -sign * (features @ w), np.r_[0.0, w[1:]]
        slope = 2 * modest - (sign * expit(against)) @ features
        return float(np.logaddexp(0, against).sum() + (modest**2).sum()), slope

    return np.asarray(minimize(loss, np.zeros(features.shape[1]), jac=True, method="BFGS").x)


def fit_cautious(rows: np.ndarray) -> np.ndarray:
    """The same of the cautious model: other features than its own have no weight, and it is fitted
    to what it judges, candidates that segments say little of."""
    doubtful = rows[_undecided(rows)]
    doubtful[:, len(CAUTIOUS_FEATURES) : ROOT] = 0.0
    return fit(doubtful)


def _undecided(rows: np.ndarray) -> np.ndarray:
    """Which candidates have no equal, and segments say little of."""
    decided = np.isin(rows[:, ROOT], (1.0, REPEATED_ROOT))
    undecided: np.ndarray = ~decided & (rows[:, EQUAL] == 0)
    return undecided


def _features(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones(len(rows)), rows[:, :ROOT]])


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
    needed = VerificationConfig().min_confidence ** (1.0 / rows[:, ROOT])
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
        believed = (q >= needed) & (rows[:, EQUAL] == 0)
        print(
            f"model of {name}: Brier score {brier:.4f}; confident (over 0.5) and wrong: {falsely};"
            f" believed: {believed[right].sum()} of {right.sum()} right ones,"
            f" {believed[~right].sum()} of {(~right).sum()} wrong ones"
        )
    for name, part in (("right", rows[right]), ("wrong", rows[~right])):
        for column, label in enumerate(COLUMNS):
            q = np.nanpercentile(part[:, column], [0, 1, 50, 99, 100])
            print(f"  {name} {label}: " + " ".join(f"{v:.2f}" for v in q))


def report_cautious(rows: np.ndarray) -> None:
    """The cautious model, and what it says of candidates that the shipped one takes for likely."""
    weights, shipped = fit_cautious(rows), probability(rows, _shipped())
    print(f"cautious model: weights {np.round(weights[: len(CAUTIOUS_FEATURES) + 1], 2)}")
    likely = _undecided(rows) & (shipped >= LIKELY)
    for name, chosen in (("right", rows[:, RIGHT] > 0), ("wrong", rows[:, RIGHT] == 0)):
        q = probability(rows[likely & chosen], weights)
        print(f"  {name} and likely: {len(q)}, of these cautiously: {(q >= CAUTIOUSLY).sum()}")


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
    axes.plot([0, 1], [0, 1], color=PATH, lw=1, ls="--")
    for low, high in pairwise(BINS):
        chosen = (p >= low) & (p < high)
        if chosen.any():
            n, k = int(chosen.sum()), int(right[chosen].sum())
            share, spread = k / n, 1.96 * np.sqrt((k + 1) * (n - k + 1) / (n + 2) ** 2 / (n + 3))
            axes.errorbar(p[chosen].mean(), share, spread, fmt="o", color=GREEN, capsize=3)
    axes.set_ylabel("share right")
    axes.set_ylim(-0.05, 1.05)
    below.hist([p[right], p[~right]], bins=20, color=[GREEN, RED], log=True)
    below.legend(["right", "wrong"], fontsize=8, frameon=False)
    below.set_xlabel("confidence, by the model of the other worlds")
    below.set_ylabel("candidates")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})


Judged = list[tuple[float, bool]]
"""The confidence in a pose, and whether it is right."""


def judged(answers: Iterable[dict[str, Any]]) -> Judged:
    """Of the answers that have a pose."""
    return [(a["confidence"], a["best"] == "found") for a in answers if a["best"]]


def table(sets: dict[str, Judged]) -> list[tuple[Cell, ...]]:
    """A row for each bin of the confidence, and one with the Brier score of each set."""
    rows: list[tuple[Cell, ...]] = []
    for low, high in pairwise(BINS):
        inside = [[right for p, right in pairs if low <= p < high] for pairs in sets.values()]
        shares = (share(sum(right), len(right)) for right in inside)
        rows.append((f"{low:.2f} to {min(high, 1.0):.2f}", *shares))
    return [*rows, ("Brier score", *(_brier(pairs) for pairs in sets.values()))]


def _brier(pairs: Judged) -> Cell:
    if not pairs:
        return None
    p, right = np.array(pairs, dtype=np.float64).T
    return round(float(((p - right) ** 2).mean()), 4)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--real", type=Path, required=True)
    options.add_argument("--simulated", type=Path, required=True)
    args = options.parse_args()
    simulated = json.loads(args.simulated.read_text()).values()
    sets = {
        "real: right": judged(json.loads(args.real.read_text())),
        "simulated: right": judged(answer for rows in simulated for answer in rows),
    }
    columns, rows = ("confidence", *sets), table(sets)
    note = "Of all queries that have a pose, believed or not; in brackets 95 % by Wilson."
    publish(args.report, "Reliability of the confidence", Table(columns, rows, note))


if __name__ == "__main__":
    main()
