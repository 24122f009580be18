"""How often each estimator finds the true pose, for every share of true matches.

python -m segloc_lab.bench.pose_success [TRIALS]
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product

from segloc.types import Float64

from ..results.store import Cell, Result
from ..script import storing
from .geometric import consensus, prosac, prune_and_solve
from .harness import optional
from .inputs import MatchProblem, match_problem

SHARES = (0.005, 0.01, 0.02, 0.05, 0.1)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("trials", nargs="?", type=int, default=20)
    given = options.parse_args()
    kiss = optional("kiss_matcher")
    estimators: dict[str, Callable[[MatchProblem], Float64]] = {
        "consensus": consensus,
        "PROSAC": prosac,
        "RANSAC": partial(prosac, ordered=False),
    }
    if kiss is not None:
        estimators["kiss-matcher"] = partial(prune_and_solve, kiss[0])
    rows: list[tuple[Cell, ...]] = []
    for true, informative in product(SHARES, (True, False)):
        found = dict.fromkeys(estimators, 0)
        for seed in range(given.trials):
            problem = match_problem(inliers=true, informative=informative, seed=seed)
            for name, estimate in estimators.items():
                found[name] += problem.found(estimate(problem))
        scores = "informative" if informative else "uninformative"
        rows.append((f"{100 * true:g} %", scores, *found.values()))
    Result.measured(
        "pose-success",
        f"python -m segloc_lab.bench.pose_success {given.trials} --store docs/results",
        ("true matches", "scores", *estimators),
        rows,
        stages=("pose",),
        note=f"Found in so many of {given.trials} trials.",
    ).tell(given.store)


if __name__ == "__main__":
    main()
