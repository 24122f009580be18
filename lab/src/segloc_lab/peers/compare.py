"""Tables of all answers to the queries of all protocols, with thresholds chosen elsewhere.

    python -m segloc_lab.peers.compare OUT/single OUT/town --report FOLDER

A system without a decision of its own accepts a query's answer above a threshold that is chosen on
other places, the queries outside of the query's square of the world: halfway between the highest
score of a wrong answer and the next score of a right one above it; without wrong answers, the
lowest score of a right one.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..outcomes import path_km
from ..report import Cell, Table, publish, reporting, wilson
from .exchange import ELSEWHERE, Answers, Clouds

LABELS = {
    "segloc-profile": "segloc",
    "segloc-profile-alone": "segloc, segments alone",
    "scan_context": "Scan Context in NumPy, GICP, overlap",
    "scan_context-alone": "Scan Context in NumPy, alone",
    "contour_context": "Contour Context in NumPy, GICP, overlap",
    "contour_context-alone": "Contour Context in NumPy, alone",
    "small_gicp": "small_gicp from a given start, overlap",
    "kiss_matcher": "KISS-Matcher, GICP, overlap",
    "kiss_matcher-inliers": "KISS-Matcher, its inliers",
    "map_closures": "map-closures",
    "open3d": "Open3D FPFH, RANSAC, ICP",
    "branch_and_bound": "2D branch and bound in NumPy, GICP, overlap",
    **{
        f"{prefix}-{name}": text.format(title)
        for name, title in (
            ("segmatch-eigen", "SegMatch-Eigen"),
            ("segmatch-esf", "SegMatch-ESF"),
            ("nsm", "NSM"),
            ("segmap", "SegMap"),
            ("esm", "ESM"),
            ("dsm", "DSM"),
        )
        for prefix, text in (("segloc", "segloc with {}"), ("published", "{} as published"))
    },
}
"""Systems by the names of their answers."""

RIGHT = ((0.5, 2.0), (2.0, 5.0), (3.0, 5.0))
"""Errors up to which a pose counts as found [m, deg]; by the last it is right, or false."""

SQUARE_M, SQUARE_OF_MAP = 100.0, 0.25
"""Side of a place [m], at most this share of the extent of the mapped path: a threshold for one is
chosen on all others."""

OURS = "segloc-profile"
NOTE = (
    "Found: of the queries within map coverage, the answers accepted within these errors. False: "
    "accepted answers beyond 3 m or 5 degrees, of queries within map coverage and outside of it; "
    "in brackets the upper end of Wilson's 95 % interval. F1max and AUC (area under precision over "
    "recall) rate the confidence, over all thresholds. processor ms: processor time of a query on "
    "one core, median / 95 %; wall ms: the same by the clock, which other programs on the machine "
    "lengthen; processor ms a right answer: that of all queries, refused ones too, divided by the "
    "right answers that are accepted; beside it, how many times segloc's. MB per km: what the "
    "system keeps of the map, per kilometre of its path. In NumPy: written for this comparison "
    "from the method's paper; compiled code of its authors takes a fraction of the time. Bold: "
    "another system has fewer false answers than segloc, or less time a right answer."
)

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """How one system did; arrays have a value per query.

    Attributes
    ----------
    system : str
        Name of its answers.
    answers : Answers
    right : (3, N) bool
        Whether the answer is within each of :data:`RIGHT`.
    taken : (N,) bool
        Answers that the system accepts or, without one, those above the threshold.
    """

    system: str
    answers: Answers
    right: Bools
    taken: Bools

    @property
    def decides(self) -> bool:
        """Whether the system has a decision of its own."""
        return bool(self.answers.decides)

    @property
    def wrong(self) -> Bools:
        """Answers that are not right, accepted or not."""
        found: Bools = answered(self.answers) & ~self.right[-1]
        return found

    @property
    def false(self) -> Bools:
        """Wrong answers that are accepted."""
        accepted: Bools = self.taken & self.wrong
        return accepted

    def taken_above(self, threshold: float) -> Bools:
        """Return the answers that another threshold accepts; a decision of its own stands."""
        if self.decides:
            return self.taken
        return answered(self.answers) & (self.answers.scores > threshold)


@dataclass(frozen=True)
class Part:
    """The queries of a protocol, how the systems did, and the length of the map."""

    name: str
    queries: Clouds
    scores: list[Score]
    map_km: float


def answered(answers: Answers) -> Bools:
    """Return which queries have an answer, accepted or not."""
    given: Bools = answers.queried & np.isfinite(answers.poses).all(axis=(1, 2))
    return given


def score(path: Path, queries: Clouds, square_m: float = SQUARE_M) -> Score:
    """Return how the system did whose answers lie in a file, with places of this size."""
    answers = Answers.load(path)
    given = answered(answers)
    right = np.stack([given & close(answers.poses, queries.poses, *each) for each in RIGHT])
    if answers.decides:
        taken = given & answers.accepted
    else:
        thresholds = left_out(
            answers.scores, given & ~right[-1], right[-1], squares(queries, square_m)
        )
        taken = given & (answers.scores > thresholds)
    return Score(path.stem.removeprefix("answers-"), answers, right, taken)


def close(poses: Floats, truths: Floats, metres: float, degrees: float) -> Bools:
    """Return which poses lie within these errors, (N,) bool."""
    off = np.linalg.norm(poses[:, :3, 3] - truths[:, :3, 3], axis=1)
    traces = np.einsum("nij,nij->n", poses[:, :3, :3], truths[:, :3, :3])
    turned = np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
    right: Bools = (off <= metres) & (turned <= degrees)
    return right


def squares(queries: Clouds, side_m: float) -> NDArray[np.int64]:
    """Return the place of each query, a square of its world, (N,) int64."""
    cells = np.floor(queries.poses[:, :2, 3] / side_m).astype(np.int64)
    keys = np.column_stack([cells, queries.group == ELSEWHERE])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


def left_out(scores: Floats, wrong: Bools, right: Bools, places: NDArray[np.int64]) -> Floats:
    """Return the threshold that the answers at all other places imply, (N,) float64."""
    others = [places != place for place in range(max(places) + 1)]
    return np.array([threshold(scores[wrong & o], scores[right & o]) for o in others])[places]


def threshold(wrong: Floats, right: Floats) -> float:
    """Return a score between the highest wrong answer and the next right one above it.

    Without wrong answers it is just below the lowest right one: worse answers were never tried.
    """
    if not len(wrong):
        return float(np.nextafter(right.min(initial=math.inf), -math.inf))
    highest = float(wrong.max())
    above = right[right > highest]
    return (highest + float(above.min())) / 2 if len(above) else highest


def scored(folder: Path, systems: Collection[str] | None = None) -> Part:
    """Return one protocol with these or all answers to it, those that find most first."""
    queries = Clouds.load(folder / "queries.npz")
    paths = {path.stem.removeprefix("answers-"): path for path in folder.glob("answers-*.npz")}
    kept = sorted(paths if systems is None else paths.keys() & systems)
    path = np.load(folder / "path.npy")
    square_m = min(SQUARE_M, SQUARE_OF_MAP * float(np.ptp(path[:, :2, 3], axis=0).max()))
    scores = [score(paths[name], queries, square_m) for name in kept]
    scores.sort(key=lambda s: -int((s.right[-1] & s.taken & queries.within_coverage).sum()))
    return Part(folder.name, queries, scores, path_km(path))


def table(part: Part, missing: Mapping[str, str] | None = None, note: str = NOTE) -> Table:
    """Return the table of a protocol; ``missing`` systems have a row that says why."""
    rows = [_row(s, part) for s in part.scores]
    for system, why in (missing or {}).items():
        rows.append({"system": label(system), "queries": why})
    return Table.of(rows, note, part.name)


def ours_of(part: Part) -> Score | None:
    """Return segloc's own score, if it answered."""
    return next((each for each in part.scores if each.system == OURS), None)


def rival_of(s: Score, part: Part) -> Score | None:
    """Return segloc's own score if the system is another one."""
    return None if s.system.startswith("segloc-") else ours_of(part)


def _row(s: Score, part: Part) -> dict[str, Cell]:
    inside, queried = part.queries.within_coverage, s.answers.queried
    place = queried & inside
    f1, auc = confidence(s, place)
    size = float(s.answers.map_bytes) / 1e6 / part.map_km if part.map_km else math.nan
    spent = ms_a_right(s, inside)
    rival, ours = rival_of(s, part), ours_of(part)
    own = ms_a_right(ours, inside) if ours else math.nan
    ratio = spent / own if math.isfinite(own) else math.nan

    def false(side: Bools) -> str:
        fewer = rival is not None and (s.false & side).sum() < (rival.false & side).sum()
        return emphasised(bounded(s.false & side, queried & side), fewer)

    quick = rival is not None and spent < ms_a_right(rival, inside)
    return {
        "system": label(s.system),
        "queries": int(queried.sum()),
        **{
            f"found {m:g} m, {deg:g} deg": _of(right & s.taken, place)
            for (m, deg), right in zip(RIGHT, s.right, strict=True)
        },
        "false in the map": false(inside),
        "false outside": false(~inside),
        "F1max": round(f1, 3),
        "AUC": round(auc, 3),
        "processor ms": _spread(s.answers.ms[queried]),
        "wall ms": _spread(s.answers.wall_ms[queried]),
        "processor ms a right answer": emphasised(f"{spent:.0f}", quick)
        if math.isfinite(spent)
        else None,
        "times segloc's": round(ratio, 2) if math.isfinite(ratio) else None,
        "MB per km": round(size, 1) if math.isfinite(size) else None,
        "trained on": str(s.answers.trained),
    }


def _of(found: Bools, among: Bools) -> str:
    return f"{int((found & among).sum())} of {int(among.sum())}"


def _spread(ms: Floats) -> str | None:
    """Format the median and the 95th percentile of times; None without any."""
    return f"{np.median(ms):.0f} / {np.percentile(ms, 95):.0f}" if len(ms) else None


def ms_a_right(s: Score, inside: Bools) -> float:
    """Return the processor time of all queries over the right answers accepted [ms]."""
    right = int((s.right[-1] & s.taken & inside).sum())
    return float(s.answers.ms[s.answers.queried].sum()) / right if right else math.inf


def emphasised(text: str, bold: bool) -> str:
    """Format text in bold, or as it is."""
    return f"**{text}**" if bold else text


def bounded(false: Bools, trials: Bools) -> str:
    """Format a count of false answers with its upper bound in percent."""
    count, total = int(false.sum()), int(trials.sum())
    return f"{count} of {total}" + (f" (< {100 * wilson(count, total)[1]:.1f} %)" if total else "")


def confidence(s: Score, place: Bools) -> tuple[float, float]:
    """Return the best F1 over all thresholds, and the area under precision over recall.

    Right answers outside of map coverage count neither way.
    """
    counted = answered(s.answers) & (place | s.wrong)
    order = np.argsort(-s.answers.scores[counted], kind="stable")
    scores, right = s.answers.scores[counted][order], s.right[-1][counted][order]
    if not right.any():
        return 0.0, 0.0
    last = np.append(np.diff(scores) != 0, True)  # equal scores are accepted together
    found = np.cumsum(right)[last]
    precision = found / (np.flatnonzero(last) + 1)
    recall = found / max(int(place.sum()), 1)
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-12)
    return float(f1.max()), float((np.diff(recall, prepend=0.0) * precision).sum())


def overview(parts: Sequence[Part]) -> Table:
    """Return one row per system with its result in each set; those that find most first."""
    cells: dict[str, dict[str, str]] = {}
    shares: defaultdict[str, float] = defaultdict(float)
    for part in parts:
        inside = part.queries.within_coverage
        for s in part.scores:
            false, spent = int(s.false.sum()), ms_a_right(s, inside)
            rival = rival_of(s, part)
            fewer = rival is not None and false < rival.false.sum()
            faster = rival is not None and spent < ms_a_right(rival, inside)
            cell = [found(s, s.taken, part.queries), emphasised(f"{false} false", bool(fewer))]
            if math.isfinite(spent):
                cell.append(emphasised(f"{spent:.0f} ms", faster))
            cells.setdefault(s.system, {})[part.name] = ", ".join(cell)
            place = s.answers.queried & inside
            shares[s.system] -= (s.right[-1] & s.taken & place).sum() / max(place.sum(), 1)
    names = [part.name for part in parts]
    rows = [(label(s), *map(cells[s].get, names)) for s in sorted(cells, key=shares.__getitem__)]
    note = (
        "Found of the queries within map coverage, false answers to all queries, and processor "
        "time a right answer; columns, bold and thresholds as below."
    )
    return Table(("system", *names), rows, note, "All sets")


def label(system: str) -> str:
    """Return the name of a system from that of its answers."""
    return LABELS.get(system, system.replace("segloc-", "segloc with "))


def grouped(part: Part) -> Table | None:
    """Return what each system finds by group of queries; None if there is one group."""
    groups = [g for g in dict.fromkeys(part.queries.group.tolist()) if g != ELSEWHERE]
    if len(groups) < 2:
        return None
    rows = [
        (label(s.system), *(found(s, s.taken, part.queries, group) for group in groups))
        for s in part.scores
    ]
    return Table(("system", *groups), rows, "", f"{part.name}, by kind of query")


def found(s: Score, taken: Bools, queries: Clouds, group: str | None = None) -> str:
    """Format how many queries within map coverage are found."""
    place = s.answers.queried & queries.within_coverage
    if group is not None:
        place = place & (queries.group == group)
    return f"{int((s.right[-1] & taken & place).sum())} of {int(place.sum())}"


def refusals(parts: Sequence[Part]) -> Table:
    """Return why the systems with a decision of their own refused queries."""
    rows = []
    for part in parts:
        inside = part.queries.within_coverage
        for s in (s for s in part.scores if s.decides):
            refused = s.answers.queried & ~s.taken
            counts = (
                Counter(s.answers.reasons[refused & side].tolist()) for side in (inside, ~inside)
            )
            rows.append((part.name, label(s.system), *map(_counted, counts)))
    return Table(("set", "system", "refused in the map", "refused outside"), rows, "", "Refusals")


def _counted(reasons: Counter[str]) -> str:
    return ", ".join(f"{n} {reason}" for reason, n in reasons.most_common()) or "none"


TRANSFER = ("set", "system", "found", "false in the map", "false outside")


def transfer(parts: Sequence[Part]) -> Table:
    """Return how systems do with a threshold of the other sets: none is known of their own."""
    rows: list[tuple[Cell, ...]] = []
    for part in parts:
        inside = part.queries.within_coverage
        for s in part.scores:
            others = [o for p in parts if p is not part for o in p.scores if o.system == s.system]
            if not others:
                continue
            wrong = np.concatenate([o.answers.scores[o.wrong] for o in others])
            right = np.concatenate([o.answers.scores[o.right[-1]] for o in others])
            taken = s.taken_above(threshold(wrong, right))
            rows.append(
                (
                    part.name,
                    label(s.system),
                    found(s, taken, part.queries),
                    bounded(taken & s.wrong & inside, s.answers.queried & inside),
                    bounded(taken & s.wrong & ~inside, s.answers.queried & ~inside),
                )
            )
    note = "Chosen by the same rule on all other sets; segloc has its own decision."
    return Table(TRANSFER, rows, note, "Thresholds of the other sets")


def tables(
    folders: Sequence[Path],
    systems: Collection[str] | None = None,
    missing: Mapping[str, str] | None = None,
) -> list[Table]:
    """Return all tables of the protocols in these folders, of these or all systems."""
    parts = [scored(folder, systems) for folder in folders]
    every = [
        each
        for part in parts
        for each in (table(part, missing, NOTE if part is parts[0] else ""), grouped(part))
        if each
    ]
    more = [transfer(parts), refusals(parts)]
    first = [overview(parts)] if len(parts) > 1 else []
    return first + every + [each for each in more if each.rows]


def main() -> None:
    parsed = reporting(__doc__)
    parsed.add_argument("folders", nargs="+", type=Path)
    options = parsed.parse_args()
    publish(options.report, "Other systems on the same clouds", *tables(options.folders))


if __name__ == "__main__":
    main()
