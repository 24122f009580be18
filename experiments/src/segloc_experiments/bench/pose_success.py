"""How often each estimator finds the true pose, for every share of true matches.

python -m segloc_experiments.bench.pose_success [TRIALS]
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from segloc.types import Float64

from ..script import head, parser, row
from .geometric import consensus, prosac, prune_and_solve
from .harness import optional
from .inputs import MatchProblem, match_problem

SHARES = (0.005, 0.01, 0.02, 0.05, 0.1)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("trials", nargs="?", type=int, default=20)
    trials = options.parse_args().trials
    kiss = optional("kiss_matcher")
    estimators: dict[str, Callable[[MatchProblem], Float64]] = {
        "consensus": consensus,
        "PROSAC": prosac,
        "RANSAC": partial(prosac, ordered=False),
    }
    if kiss is not None:
        estimators["kiss-matcher"] = partial(prune_and_solve, kiss[0])
    print(f"Poses found (1 m, 3 degrees) in {trials} trials of 7500 matches\n")
    print(head("true matches", "scores", *estimators))
    for share in SHARES:
        for informative in (True, False):
            found = dict.fromkeys(estimators, 0)
            for seed in range(trials):
                problem = match_problem(inliers=share, informative=informative, seed=seed)
                for name, estimate in estimators.items():
                    found[name] += problem.found(estimate(problem))
            scores = "informative" if informative else "uninformative"
            print(row(f"{100 * share:g} %", scores, *found.values()), flush=True)


if __name__ == "__main__":
    main()
