"""Fits how likely a pose from landmarks is to be right, on simulated stands of trees.

    python -m segloc_lab.calibration.landmarks

Wild and planted stands are mapped along a path and queried up to 16 m beside it, seeing 20 to 100 %
of the stems within 8 to 28 m, with noise of 5 to 15 cm and up to 40 % false detections: in their
own map, in its mirror image and in the map of another stand. Every query gets its best pose,
believed or not; a logistic regression on the logarithms of its share, of its ratio to the rival and
of its support gives the probability that it is right. Nothing real is among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from segloc_stems import (
    LandmarkConfig,
    LandmarkLocalizer,
    LandmarkMap,
    LandmarkMapper,
    Landmarks,
    levelling,
)

from segloc import geometry
from segloc.types import Float64, Pose

from ..outcomes import pose_error
from ..script import parser

LEAN_RAD = math.radians(4.0)


@dataclass(frozen=True)
class Detector:
    """What is seen of the stems around a pose.

    Attributes
    ----------
    keep : float
        Share of the stems that are found.
    noise_m : float
        Standard deviation of positions along each axis; diameters have a third of it.
    invented : float
        Share of detections where no stem is.
    """

    radius_m: float = 25.0
    keep: float = 0.85
    noise_m: float = 0.08
    invented: float = 0.1

    def seen(self, stems: Landmarks, T_map_sensor: Pose, rng: np.random.Generator) -> Landmarks:
        """Detections in the sensor's frame."""
        assert stems.diameters is not None
        local = geometry.transform(geometry.inverse(T_map_sensor), stems.positions)
        near = np.hypot(local[:, 0], local[:, 1]) < self.radius_m
        near &= rng.random(len(local)) < self.keep
        count = int(near.sum())
        positions = local[near] + rng.normal(0, self.noise_m, (count, 3))
        wrong = rng.random(count) < self.invented
        positions[wrong, :2] = rng.uniform(-self.radius_m, self.radius_m, (wrong.sum(), 2))
        axes = stems.directions[near] @ T_map_sensor[:3, :3]
        diameters = stems.diameters[near] + rng.normal(0, self.noise_m / 3, count)
        return Landmarks(positions, axes, np.maximum(diameters, 0.03))


def wild(rng: np.random.Generator, size_m: float, a_hectare: float) -> Landmarks:
    """Stems that stand at random, at least 0.8 m apart, on rolling ground."""
    count = rng.poisson(a_hectare * (size_m / 100) ** 2)
    where = rng.uniform(0, size_m, (count, 2))
    crowded = {b for _, b in cKDTree(where).query_pairs(0.8)}
    return _grown(np.delete(where, sorted(crowded), axis=0), rng)


def planted(rng: np.random.Generator, size_m: float) -> Landmarks:
    """Stems in rows 4 m apart, every 2.5 m, a tenth of them gone."""
    x, y = np.meshgrid(np.arange(0, size_m, 4.0), np.arange(0, size_m, 2.5))
    where = np.stack([x.ravel(), y.ravel()], axis=1)
    where = where[rng.random(len(where)) < 0.9]
    return _grown(where + rng.normal(0, 0.3, where.shape), rng)


def surveyed(stems: Landmarks, path: Float64, rng: np.random.Generator) -> LandmarkMap:
    """The map that a detector makes of them along a path of (V, 2) points."""
    mapper = LandmarkMapper()
    for x, y in path:
        T = pose_at(x, y, rng)
        mapper.add(Detector().seen(stems, T, rng), T)
    return mapper.map()


def mirrored(prior_map: LandmarkMap) -> LandmarkMap:
    """The mirror image of a map: as likely a place, and none of its queries is in it."""
    flip = np.array([-1.0, 1.0, 1.0])
    return replace(prior_map, positions=prior_map.positions * flip, axes=prior_map.axes * flip)


def pose_at(x: float, y: float, rng: np.random.Generator) -> Pose:
    """T_map_sensor 1.5 m above the ground there, any heading, a little off level."""
    T = geometry.yaw_transform(rng.uniform(-math.pi, math.pi), (x, y, height(x, y) + 1.5))
    pitch, roll = rng.normal(0, math.radians(5.0), 2)
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    tilt = np.array([[cp, sp * sr, sp * cr], [0, cr, -sr], [-sp, cp * sr, cp * cr]])
    return T @ geometry.rigid(tilt, np.zeros(3))


def height(x: float, y: float) -> float:
    """Of the ground, metres."""
    return 2.0 * math.sin(x / 23.0) + 1.5 * math.cos(y / 31.0)


def _grown(where: Float64, rng: np.random.Generator) -> Landmarks:
    ground = np.array([height(x, y) for x, y in where])
    lean = rng.normal(0, LEAN_RAD, (len(where), 2))
    axes = np.column_stack([lean, np.ones(len(where))])
    diameters = np.clip(rng.lognormal(math.log(0.25), 0.4, len(where)), 0.06, 1.2)
    return Landmarks(np.column_stack([where, ground]), axes, diameters)


SIZE_M = 120.0
RIGHT_M, RIGHT_DEG = 1.0, 5.0
RIDGE = 0.01
"""Keeps the weights finite where right and wrong are told apart without fault."""


def stands(seed: int) -> Iterator[tuple[Landmarks, LandmarkMap, np.random.Generator]]:
    """Stands with the maps that were made of them."""
    path = np.stack([np.linspace(25, 95, 15), np.linspace(40, 80, 15)], axis=1)
    for kind in range(8):
        rng = np.random.default_rng((seed, kind))
        if kind < 6:
            stems = wild(rng, SIZE_M, a_hectare=(200, 500, 1000)[kind % 3])
        else:
            stems = planted(rng, SIZE_M)
        yield stems, surveyed(stems, path, rng), rng


def outcomes(seed: int, queries: int) -> Iterator[tuple[tuple[float, ...], bool]]:
    """Features of the best pose of each query, and whether it is right."""
    others = [made for _, made, _ in stands(seed + 1)]
    config = LandmarkConfig()
    config = config.model_copy(update={"efforts": config.efforts[-1:]})
    for k, (stems, own, rng) in enumerate(stands(seed)):
        maps = (own, own, mirrored(own), others[k])
        localizers = [LandmarkLocalizer(prior_map, config) for prior_map in maps]
        for i in range(queries):
            share = i / max(queries - 1, 1)
            where = rng.uniform(-16, 16, 2) + [25 + 70 * share, 40 + 40 * share]
            T = pose_at(where[0], where[1], rng)
            radius, keep, noise, invented = rng.uniform([8, 0.2, 0.05, 0.0], [28, 1.0, 0.15, 0.4])
            query = Detector(radius, keep, noise, invented).seen(stems, T, rng)
            T_local_sensor = levelling(query.directions)
            search, _ = localizers[i % 4].search(query.transform(T_local_sensor))
            for place in search.posterior.places[:1]:
                T_found = place.T_map_local @ T_local_sensor
                metres, degrees = pose_error(T_found, T)
                yield place.features, metres < RIGHT_M and degrees < RIGHT_DEG and i % 4 < 2


def fitted(rows: Float64, right: Float64) -> Float64:
    """Weights of a logistic regression with a ridge, by Newton's method.

    Parameters
    ----------
    rows : (N, D) float64
    right : (N,) float64
        1 or 0.
    """
    weights = np.zeros(rows.shape[1])
    for _ in range(100):
        p = 1 / (1 + np.exp(-rows @ weights))
        gradient = rows.T @ (right - p) - RIDGE * weights
        curvature = (rows * (p * (1 - p))[:, None]).T @ rows + RIDGE * np.eye(len(weights))
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights


def table(found: list[tuple[tuple[float, ...], bool]]) -> tuple[Float64, Float64]:
    """Rows of features, and what is right as 1 or 0."""
    rows, right = zip(*found, strict=True)
    return np.array(rows), np.array(right, np.float64)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--queries", type=int, default=120, help="of each stand")
    options.add_argument("--seed", type=int, default=100)
    args = options.parse_args()
    rows, right = table(list(outcomes(args.seed, args.queries)))
    held_rows, held_right = table(list(outcomes(args.seed + 50, args.queries)))
    weights = fitted(rows, right)
    p = 1 / (1 + np.exp(-held_rows @ weights))
    print(f"weights: {', '.join(f'{w:.2f}' for w in weights)}")
    print(f"{int(right.sum())} of {len(right)} right; others: Brier score")
    print(f"{np.mean((p - held_right) ** 2):.4f}, {int(held_right.sum())} of {len(p)} right")
    wrong = np.column_stack([p, held_rows])[held_right == 0]
    print("most likely wrong ones (probability, share, ratio, support):")
    for likely, _, *logs in wrong[np.argsort(-wrong[:, 0])][:5]:
        print(f"  {likely:.3f}", *(f"{value:.2f}" for value in np.exp(logs)))
    threshold = LandmarkConfig().min_confidence
    print(f"right and believed: {int((held_right * (p >= threshold)).sum())}")


if __name__ == "__main__":
    main()
