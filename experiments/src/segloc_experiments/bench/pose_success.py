"""Candidate poses against kiss-matcher: time, and how often each finds the true pose.

``python benchmarks/bench_pose.py [TRIALS]``
"""

import sys

from .geometric import consensus, prosac, prune_and_solve
from .harness import optional
from .inputs import match_problem
from .rows import main

SHARES = (0.005, 0.01, 0.02, 0.05, 0.1)


def success(trials: int) -> None:
    """Print how many of the trials each estimator solves, for every share of true matches."""
    kiss = optional("kiss_matcher")
    estimators = {
        "consensus": consensus,
        "PROSAC": prosac,
        "RANSAC": lambda problem: prosac(problem, ordered=False),
    }
    if kiss is not None:
        estimators["kiss-matcher"] = lambda problem: prune_and_solve(kiss[0], problem)
    print(f"\npose found (1 m, 3 degrees) in {trials} trials of 7500 matches")
    print(f"{'true matches':>14} {'scores':>14} " + "".join(f"{n:>14}" for n in estimators))
    for share in SHARES:
        for informative in (True, False):
            found = dict.fromkeys(estimators, 0)
            for seed in range(trials):
                problem = match_problem(inliers=share, informative=informative, seed=seed)
                for name, estimate in estimators.items():
                    found[name] += problem.found(estimate(problem))
            scores = "informative" if informative else "uninformative"
            counts = "".join(f"{count:>14}" for count in found.values())
            print(f"{100 * share:>12.1f} % {scores:>14} {counts}")


if __name__ == "__main__":
    main("pose")
    success(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
