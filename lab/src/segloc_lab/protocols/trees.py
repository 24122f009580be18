"""Tree stems as landmarks: a real forest, each frame against the map of earlier frames.

    python -m segloc_lab.protocols.trees DATA --out trees.jsonl

DATA is a folder with ``trees.npz`` (rows of base, axis, diameter; offsets of the frames) and
``poses.tum``. A query is one frame. Its map has all frames more than 50 m of path behind it: a
revisit, if one of them is within 3 m. Each query runs once unchanged, and once with half of the
landmarks of the map and of the query removed independently and the others moved at random by 0.1 m
along each axis. Every eighth also runs in the mirror image of the map.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from segloc_stems import LandmarkLocalizer, LandmarkMap, LandmarkMapper, Landmarks

from segloc import geometry
from segloc.tools.io import read_trajectory
from segloc.types import Float64, Int64

from ..calibration.landmarks import mirrored as mirror_image
from ..outcomes import pose_error
from ..report import Cell, Table, publish, share, wilson
from ..runner import Runner

BEHIND_M = 50.0
REVISIT_M = 3.0
RIGHT_M, RIGHT_DEG = 2.0, 5.0
FAR_M = 3.0
"""Poses of two passes agree roughly; larger errors are certain [m]."""


@dataclass(frozen=True)
class Forest:
    """Detections of N frames with their poses.

    Attributes
    ----------
    poses : (N, 4, 4) float64
    behind : (N,) int64
        How many frames lie far enough behind each.
    gaps : (N,) float64
        Distance to the nearest of those, metres; infinite without any.
    """

    frames: list[Landmarks]
    poses: Float64
    behind: Int64
    gaps: Float64

    @classmethod
    def load(cls, folder: Path) -> Forest:
        with np.load(folder / "trees.npz") as file:
            rows, offsets = file["rows"].astype(np.float64), file["offsets"]
        frames = [
            Landmarks(part[:, :3], part[:, 3:6], part[:, 7])
            for part in np.split(rows, offsets[1:-1])
        ]
        poses = read_trajectory(folder / "poses.tum").poses
        path = geometry.distance_travelled(poses)
        behind = np.searchsorted(path, path - BEHIND_M)
        gaps = np.full(len(poses), np.inf)
        for k, count in enumerate(behind):
            if count:
                steps = poses[:count, :3, 3] - poses[k, :3, 3]
                gaps[k] = np.linalg.norm(steps, axis=1).min()
        return cls(frames, poses, behind, gaps)

    def queries(self, every: int) -> Iterator[tuple[int, LandmarkMap]]:
        """Return frame numbers with earlier frames, each with their map."""
        mapper, added = LandmarkMapper(), 0
        for k in np.flatnonzero(self.behind)[::every]:
            for i in range(added, self.behind[k]):
                mapper.add(self.frames[i], self.poses[i])
            added = int(self.behind[k])
            yield int(k), mapper.map()


@dataclass(frozen=True)
class Thinning:
    """Share of landmarks kept, and noise along each axis.

    Map and query are thinned independently, and anew for each query.
    """

    keep: float = 1.0
    noise_m: float = 0.0

    def query(self, landmarks: Landmarks, number: int) -> Landmarks:
        """Return the remaining landmarks of a query."""
        kept, noise = self._drawn(len(landmarks), (0, 0, number))
        assert landmarks.diameters is not None
        positions = (landmarks.positions + noise)[kept]
        return Landmarks(positions, landmarks.directions[kept], landmarks.diameters[kept])

    def map(self, prior_map: LandmarkMap, number: int) -> LandmarkMap:
        """Return the remaining map for one query."""
        kept, noise = self._drawn(len(prior_map), (0, 1, number))
        return LandmarkMap(
            (prior_map.positions + noise)[kept],
            prior_map.axes[kept],
            prior_map.diameters[kept],
            prior_map.views[kept],
            prior_map.trajectory,
        )

    def _drawn(self, count: int, seed: tuple[int, ...]) -> tuple[NDArray[np.bool_], Float64]:
        rng = np.random.default_rng(seed)
        return rng.random(count) < self.keep, rng.normal(0, self.noise_m, (count, 3))


@dataclass(frozen=True)
class Outcome:
    """Outcome of one query."""

    frame: int
    gap_m: float
    reason: str
    metres: float
    degrees: float
    milliseconds: float
    efforts: int

    @property
    def right(self) -> bool:
        return self.metres <= RIGHT_M and self.degrees <= RIGHT_DEG

    @property
    def false(self) -> bool:
        return not self.reason and not self.right

    @property
    def far(self) -> bool:
        """True if the error exceeds that of the poses themselves."""
        return self.false and (self.metres > FAR_M or self.degrees > RIGHT_DEG)


def outcomes(forest: Forest, thinning: Thinning, every: int, mirrored: bool) -> Iterator[Outcome]:
    """Return every query's outcome; in the mirrored map every pose is false."""
    for k, whole in forest.queries(every):
        prior_map = thinning.map(whole, k)
        if mirrored:
            prior_map = mirror_image(prior_map)
        localizer = LandmarkLocalizer(prior_map, clock=time.process_time)
        answer = localizer.localize(thinning.query(forest.frames[k], k))
        metres, degrees = pose_error(answer.T_map_sensor, None if mirrored else forest.poses[k])
        reason = "" if answer.localized else str(answer.reason)
        efforts = answer.counts.get("efforts", 1)
        total = answer.times_ms["total"]
        yield Outcome(k, float(forest.gaps[k]), reason, metres, degrees, total, efforts)


def summary(found: list[Outcome]) -> dict[str, Any]:
    """Return figures of one run as JSON values."""
    revisits = [o for o in found if o.gap_m <= REVISIT_M]
    others = [o for o in found if o.gap_m > REVISIT_M]
    times = np.array([o.milliseconds for o in revisits])
    errors = np.array([(o.metres, o.degrees) for o in revisits if o.right]).reshape(-1, 2)
    reasons = sorted({o.reason for o in found if o.reason})
    figures: dict[str, Any] = {
        "queries": len(found),
        "revisits": len(revisits),
        "found": sum(o.right for o in revisits),
        "others": len(others),
        "others_found": sum(o.right for o in others),
        "false": sum(o.false for o in found),
        "false_beyond_3_m": sum(o.far for o in found),
        "reasons": {reason: sum(o.reason == reason for o in found) for reason in reasons},
        "ms_median": _quantile(times, 50),
        "ms_95": _quantile(times, 95),
        "ms_all_median": _quantile(np.array([o.milliseconds for o in found]), 50),
        "ms_all_95": _quantile(np.array([o.milliseconds for o in found]), 95),
        "second_effort": sum(o.efforts > 1 for o in revisits),
        "metres_median": _quantile(errors[:, 0], 50),
        "metres_95": _quantile(errors[:, 0], 95),
        "degrees_95": _quantile(errors[:, 1], 95),
    }
    figures["found_95"] = wilson(figures["found"], len(revisits))
    figures["false_95"] = wilson(figures["false"], len(found))
    return figures


def _quantile(values: Float64, percent: float) -> float | None:
    return round(float(np.percentile(values, percent)), 3) if len(values) else None


WAYS: dict[str, tuple[Thinning, int, bool]] = {
    "all": (Thinning(), 1, False),
    "50 %, moved by 0.1 m": (Thinning(0.5, 0.1), 1, False),
    "all, mirrored maps": (Thinning(), 8, True),
}
"""Share of stems kept, thinning of queries, and whether the map is mirrored."""
COLUMNS = ("stems", "revisits found", "of others", "false of all", "ms, median / 95 %", "error m")


def cells(name: str, run: Mapping[str, Any]) -> tuple[Cell, ...]:
    """Return a row of the table."""
    return (
        name,
        share(run["found"], run["revisits"]),
        f"{run['others_found']} of {run['others']}",
        f"{run['false']} of {run['queries']} (below {100 * run['false_95'][1]:.2f} %)",
        " / ".join("-" if ms is None else f"{ms:.1f}" for ms in (run["ms_median"], run["ms_95"])),
        run["metres_median"] and round(run["metres_median"], 2),
    )


def report(runs: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish the table."""
    rows = [cells(run["stems"], run) for run in runs]
    note = "In brackets 95 % by Wilson. Milliseconds of processor time of one thread."
    publish(folder, "Tree stems in a real forest", Table(COLUMNS, rows, note))


def main() -> None:
    runner = Runner(__doc__, "trees.jsonl")
    runner.options.add_argument("data", type=Path)
    runner.options.add_argument("--every", type=int, default=1, help="use every N-th query")
    args = runner.parse()
    forest = Forest.load(args.data)

    def run(name: str) -> dict[str, Any]:
        thinning, every, mirrored = WAYS[name]
        found = list(outcomes(forest, thinning, every * args.every, mirrored))
        for outcome in found:
            missed = outcome.reason and outcome.gap_m <= REVISIT_M and not mirrored
            if outcome.false or missed:
                print(outcome)
        return {"stems": name, **summary(found)}

    report(runner.run(run, WAYS, ("stems",), lambda name: [name]), args.report)


if __name__ == "__main__":
    main()
