"""A building whose storeys are alike: how well a scan fits the storey that it was not taken on.

Two storeys of one plan are mapped. Single scans of another day, on the lower one, are compared with
both where they were taken, and localized in the map of both. ``differ`` is the share of the places
for furniture where the storeys have their own: at 0 only doors, chairs and people tell them apart.

    python -m segloc_lab.protocols.equal_storeys --store docs/results
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from segloc import Config, Localization, Localizer, Reason, build_map, geometry
from segloc.batch.score import Tolerance, pose_errors
from segloc.types import Float64, Pose

from ..evaluation.intervals import share
from ..recordings import Kept, Unposed
from ..results.store import Result
from ..script import storing
from ..simulation import Conditions, SimulatedSequence, building, simulate_sessions, vlp16

WITHIN_M = 0.2
LENGTH_M, SPACING_M = 40.0, 2.0
TOLERANCE = Tolerance()
COLUMNS = (
    "differ",
    "fits its storey",
    "fits the other",
    "right storey",
    "wrong storey",
    "ambiguous",
    "other refusals",
)


def drives(seed: int, differ: float) -> tuple[list[SimulatedSequence], SimulatedSequence]:
    """A drive to be mapped on each storey, and a later one on the lower storey."""
    world = building(seed, size_m=30.0, storeys=2, differ=differ)
    days = [Conditions(), Conditions(replaced=0.1)]
    lower, later = simulate_sessions(
        world, vlp16(900), days, length_m=LENGTH_M, spacing_m=SPACING_M, seed=seed
    )
    (upper,) = simulate_sessions(
        world, vlp16(900), days[:1], length_m=LENGTH_M, spacing_m=SPACING_M, seed=seed, storey=1
    )
    return [lower, upper], later


def cloud(drive: SimulatedSequence | Kept) -> Float64:
    """All points of a drive, world frame."""
    clouds = [geometry.transform(drive.poses[i], drive.scan(i).points) for i in range(len(drive))]
    return np.concatenate(clouds)


def lifted(mapped: list[SimulatedSequence], T: Pose) -> Pose:
    """The same pose on the upper storey."""
    T = T.copy()
    T[2, 3] += float(mapped[1].poses[0, 2, 3] - mapped[0].poses[0, 2, 3])
    return T


def fits(mapped: list[SimulatedSequence], later: SimulatedSequence, every: int) -> Float64:
    """Share of each query's points near something, on its storey and on the other, (N, 2)."""
    trees = [cKDTree(cloud(drive)) for drive in mapped]
    found = []
    for i in range(0, len(later), every):
        points = later.scan(i).points[::5]
        poses = (later.poses[i], lifted(mapped, later.poses[i]))
        gaps = [
            tree.query(geometry.transform(T, points), distance_upper_bound=WITHIN_M)[0]
            for tree, T in zip(trees, poses, strict=True)
        ]
        found.append([float(np.isfinite(gap).mean()) for gap in gaps])
    return np.array(found)


def answers(
    mapped: list[SimulatedSequence], later: SimulatedSequence, every: int
) -> Iterator[tuple[Localization, Pose]]:
    """What is answered in the map of both storeys, and the truth."""
    config = Config(threads=1)
    lower, upper = (build_map(drive, config) for drive in mapped)
    localizer = Localizer(lower.merge(upper), config)
    alone = Unposed(later)
    for i in range(0, len(later), every):
        yield localizer.localize(alone.scan(i)), later.poses[i]


def outcome(answer: Localization, truth: Pose) -> str:
    """A word for an answer."""
    if answer.T_map_sensor is None:
        return "ambiguous" if answer.reason is Reason.AMBIGUOUS else "refused"
    (metres,), (degrees,) = pose_errors(answer.T_map_sensor[None], truth[None])
    right = metres <= TOLERANCE.metres and degrees <= TOLERANCE.degrees
    return "right" if right and abs(answer.T_map_sensor[2, 3] - truth[2, 3]) < 1.5 else "wrong"


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--seeds", type=int, nargs="+", default=[7300, 7301])
    options.add_argument("--differ", type=float, nargs="+", default=[0.0, 0.5, 1.0])
    options.add_argument("--every", type=int, default=2, help="of so many scans, one")
    args = options.parse_args()
    rows = []
    for differ in args.differ:
        both, found = [], Counter[str]()
        for seed in args.seeds:
            mapped, later = drives(seed, differ)
            both.append(fits(mapped, later, args.every))
            found.update(outcome(*each) for each in answers(mapped, later, args.every))
        own, other = (f"{100 * value:.1f} %" for value in np.median(np.concatenate(both), axis=0))
        total = sum(found.values())
        rest = (found[name] for name in ("wrong", "ambiguous", "refused"))
        rows.append((differ, own, other, share(found["right"], total), *rest))
    command = "python -m segloc_lab.protocols.equal_storeys --store docs/results"
    note = (
        f"Share of a scan's points within {WITHIN_M:g} m of anything, median; answers of "
        "`profile` in the map of both storeys, 95 % by Wilson."
    )
    made = Result.measured("equal-storeys", command, COLUMNS, rows, methods=("profile",), note=note)
    made.tell(args.store)


if __name__ == "__main__":
    main()
