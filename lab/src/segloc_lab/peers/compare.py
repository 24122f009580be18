"""One table of all answers to a protocol, each peer at its best threshold with no false answer.

    python -m segloc_lab.peers.compare OUT/single OUT/town [--curve FIGURE.svg]

The threshold of a system without a verdict of its own is the highest score of any of its wrong
answers to these very queries: no user could know it, so this favours the peers. ``all taken`` is
what its best answers are worth without a threshold. An answer is right within 3 m and 5 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..report import Cell, Table, publish, reporting
from .exchange import Answers, Clouds

LABELS = {
    "segloc-profile": "segloc",
    "scan_context": "Scan Context",
    "kiss_matcher": "KISS-Matcher",
    "map_closures": "map-closures",
    "-shifted": ", shifted",
    "-top3": ", GICP, overlap",
    "-inliers": ", its inliers",
    "-alone": " alone",
    "-scan": "",
    "-long": "",
    "-short": "",
}
"""Parts of the names of answers, as people read them."""

RIGHT_M, RIGHT_DEG = 3.0, 5.0
ELSEWHERE = "elsewhere"

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Score:
    """How one system did; arrays have a value a query.

    Attributes
    ----------
    queried, right, taken : (N,) bool
        Taken are the answers above the threshold or, with a verdict, those that it believes.
    scores : (N,) float64
    threshold : float
        NaN for a system with a verdict of its own.
    """

    system: str
    queried: Bools
    right: Bools
    taken: Bools
    scores: NDArray[np.float64]
    threshold: float
    ms: float

    def above(self, threshold: float) -> Bools:
        """The right answers that another threshold would take; its own verdict stands."""
        return self.right & (self.taken if math.isnan(self.threshold) else self.scores > threshold)


Part: TypeAlias = tuple[Clouds, list[Score]]
"""The queries of a protocol and how the systems did."""


def score(path: Path, queries: Clouds) -> Score:
    answers = Answers.load(path)
    given = answers.queried & np.isfinite(answers.poses).all(axis=(1, 2))
    right = given & close(answers.poses, queries.poses)
    threshold = math.nan
    taken = given
    if not answers.verdict:
        wrong = given & ~right
        threshold = float(answers.scores[wrong].max()) if wrong.any() else -math.inf
        taken = given & (answers.scores > threshold)
    name = path.stem.removeprefix("answers-")
    ms = float(np.median(answers.ms[answers.queried]))
    return Score(name, answers.queried, right, taken, answers.scores, threshold, ms)


def close(poses: NDArray[np.float64], truths: NDArray[np.float64]) -> Bools:
    """Which poses are right, (N,) bool."""
    metres = np.linalg.norm(poses[:, :3, 3] - truths[:, :3, 3], axis=1)
    traces = np.einsum("nij,nij->n", poses[:, :3, :3], truths[:, :3, :3])
    degrees = np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
    right: Bools = (metres <= RIGHT_M) & (degrees <= RIGHT_DEG)
    return right


def scored(folder: Path) -> Part:
    """One protocol with all answers to it, those that find most first."""
    queries = Clouds.load(folder / "queries.npz")
    scores = [score(path, queries) for path in sorted(folder.glob("answers-*.npz"))]
    scores.sort(key=lambda s: -int((s.right & s.taken & queries.within_coverage).sum()))
    return queries, scores


def table(part: Part) -> tuple[tuple[str, ...], list[tuple[Cell, ...]]]:
    """Columns, and a row a system."""
    queries, scores = part
    groups = [g for g in dict.fromkeys(queries.group.tolist()) if g != ELSEWHERE]
    columns = ("system", "queries", *groups, "false", "all taken", "threshold", "ms")
    return columns, [_row(s, queries, groups) for s in scores]


def _row(s: Score, queries: Clouds, groups: list[str]) -> tuple[Cell, ...]:
    decides = math.isnan(s.threshold)
    place = s.queried & queries.within_coverage
    return (
        label(s.system),
        int(s.queried.sum()),
        *(found(s, queries, queries.group == group) for group in groups),
        int((s.taken & ~s.right).sum()),
        None if decides else f"{int((s.right & place).sum())} of {int(place.sum())}",
        "own verdict" if decides else f"{s.threshold:.3g}",
        round(s.ms),
    )


def label(system: str) -> str:
    """The name of a system, of that of its answers."""
    for part, words in LABELS.items():
        system = system.replace(part, words)
    return system


def found(s: Score, queries: Clouds, member: Bools) -> str:
    place = s.queried & queries.within_coverage & member
    return f"{int((s.right & s.taken & place).sum())} of {int(place.sum())}"


TOGETHER = ("system", "protocols", "threshold each", "one threshold")


def summary(parts: Sequence[Part]) -> list[tuple[Cell, ...]]:
    """What each system finds in all protocols, with a threshold for each and with one.

    One threshold is what a user could set, the highest that any of the protocols needs.
    """
    rows: list[tuple[Cell, ...]] = []
    for system in dict.fromkeys(label(s.system) for _, scores in parts for s in scores):
        own = [(q, s) for q, scores in parts for s in scores if label(s.system) == system]
        highest = max(s.threshold for _, s in own)
        places = sum(int((s.queried & q.within_coverage).sum()) for q, s in own)
        each = sum(int((s.right & s.taken & q.within_coverage).sum()) for q, s in own)
        one = sum(int((s.above(highest) & q.within_coverage).sum()) for q, s in own)
        rows.append((system, len(own), f"{each} of {places}", f"{one} of {places}"))
    return rows


def curve(parts: Sequence[Part], systems: list[str], file: Path) -> None:
    """Draw the share found over the sideways distance from the mapped path."""
    import matplotlib.pyplot as plt

    plt.rcParams["svg.hashsalt"] = "segloc"
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    for system in systems:
        counts: dict[float, list[int]] = {}
        for queries, scores in parts:
            for s in (s for s in scores if s.system == system):
                for i in np.flatnonzero(s.queried & np.char.endswith(queries.group, "m beside")):
                    offset = float(queries.group[i].split()[0])
                    counts.setdefault(offset, []).append(int(s.right[i] and s.taken[i]))
        x = sorted(counts)
        axes.plot(x, [100 * np.mean(counts[o]) for o in x], marker="o", label=label(system))
    axes.set(xlabel="metres beside the mapped path", ylabel="found, %", ylim=(-3, 103))
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    figure.savefig(file, metadata={"Date": None})


def main() -> None:
    parsed = reporting(__doc__)
    parsed.add_argument("folders", nargs="+", type=Path)
    parsed.add_argument("--curve", type=Path, help="draw the simulated offsets of all folders")
    parsed.add_argument("--drawn", nargs="*", default=[], help="the systems in the curve")
    options = parsed.parse_args()
    parts = {folder.name: scored(folder) for folder in options.folders}
    tables = {name: table(part) for name, part in parts.items()}
    tables["together"] = (TOGETHER, summary(list(parts.values())))
    found = (Table(columns, rows, title=name) for name, (columns, rows) in tables.items())
    publish(options.report, "Other systems on the same clouds", *found)
    if options.curve:
        curve(list(parts.values()), options.drawn, options.curve)


if __name__ == "__main__":
    main()
