"""Fit the confidence of a pose on simulated towns, and show how reliable it is.

Every town is mapped once; its second traversal gives queries with a true place, its neighbour's
gives negatives. Each query is asked with accumulated scans and with a single one, all gates of
verification open, so that the best candidate is always refined and shown. The logistic model of
``segloc.verification.confidence`` is then fitted to (inliers, overlap) -> right or wrong.

    python benchmarks/calibrate_confidence.py --towns 8 --out calibration.npz
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from segloc import Config, Localizer, build_map, geometry
from segloc.evaluation.localization import query_positions
from segloc.local_cloud import window
from segloc.simulation import demo_sessions

EVERY_M = 8.0
OPEN_GATES = {"min_inliers": 2, "min_overlap": 0.0, "min_confidence": 0.0, "ambiguity": 1e9}


def collect(seed: int, method: str) -> np.ndarray:
    """Rows (inliers, overlap, right) of all queries against one town's map."""
    config = Config.preset(method)
    gates = config.verification.model_copy(update=OPEN_GATES)
    drives = demo_sessions(seed)
    site = build_map(drives["map"], config)
    localizer = Localizer(site, config.model_copy(update={"verification": gates}))
    rows = []
    for name in ("revisit", "elsewhere"):
        drive = drives[name]
        for i in query_positions(drive.poses, EVERY_M, config.local_cloud.max_gap_m):
            behind = window(
                drive.poses, i, config.local_cloud.window_m, centred=False, max_gap_m=10
            )
            for scans in ([drive.scan(k) for k in behind], drive.scan(i)):
                result = localizer.localize(scans)
                if result.T_map_sensor is None:
                    continue
                delta = geometry.inverse(drive.poses[i]) @ result.T_map_sensor
                right = name == "revisit" and np.linalg.norm(delta[:3, 3]) < 1.0
                rows.append((result.inliers, result.overlap, right))
    return np.array(rows, float).reshape(-1, 3)


def fit(rows: np.ndarray) -> np.ndarray:
    """Weights (constant, log inliers, overlap) of a logistic model.

    Simulated right and wrong poses are nearly separable, which alone would make a fit as sure as
    its data are many; the penalty keeps it modest for the real world.
    """
    features = np.column_stack([np.ones(len(rows)), np.log(rows[:, 0]), rows[:, 1]])
    sign = np.where(rows[:, 2] > 0, 1.0, -1.0)

    def loss(w: np.ndarray) -> float:
        return float(np.logaddexp(0, -sign * (features @ w)).sum() + 0.3 * (w[1:] ** 2).sum())

    return np.asarray(minimize(loss, np.zeros(3), method="BFGS").x)


def report(rows: np.ndarray, weights: np.ndarray) -> None:
    """Reliability in bins of confidence, and the gap between right and wrong."""
    score = weights[0] + weights[1] * np.log(rows[:, 0]) + weights[2] * rows[:, 1]
    p, right = 1 / (1 + np.exp(-score)), rows[:, 2] > 0
    print(f"{len(rows)} candidates, {int(right.sum())} right; weights {np.round(weights, 2)}")
    for low, high in pairwise((0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0 + 1e-9)):
        chosen = (p >= low) & (p < high)
        if chosen.any():
            share = right[chosen].mean()
            print(f"  {low:.2f}-{high:.2f}: {chosen.sum():5d}  right {share:.3f}")
    for name, part in (("right", rows[right]), ("wrong", rows[~right])):
        for column, label in ((0, "inliers"), (1, "overlap")):
            q = np.percentile(part[:, column], [0, 1, 50, 99, 100])
            print(f"  {name} {label}: " + " ".join(f"{v:.2f}" for v in q))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--towns", type=int, default=8)
    parser.add_argument("--first-seed", type=int, default=3000)
    parser.add_argument("--method", default="profile")
    parser.add_argument("--out", type=Path, default=Path("calibration.npz"))
    args = parser.parse_args()
    parts = []
    for seed in range(args.first_seed, args.first_seed + args.towns):
        parts.append(collect(seed, args.method))
        print(f"town {seed}: {len(parts[-1])} candidates", flush=True)
        rows = np.concatenate(parts)
        np.savez(args.out, rows=rows, towns=np.repeat(np.arange(len(parts)), list(map(len, parts))))
    report(rows, fit(rows))


if __name__ == "__main__":
    main()
