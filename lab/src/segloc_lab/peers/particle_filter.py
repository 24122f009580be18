"""Adaptive Monte Carlo localization on an exported occupancy grid: a tracker as most robots run it.

Written from Probabilistic Robotics (Thrun, Burgard and Fox, 2005): particles move by odometry, a
likelihood field weighs them (6.4), samples of a changing number are drawn by KLD sampling (8.3.7),
and poses drawn at random join them once views fit worse than they did (augmented MCL, 8.3.3). As in
Nav2's AMCL, 60 beams count, the cubes of their likelihoods add up, and the pose is the mean of the
heaviest cluster.

The grid is one of ``segloc export --to nav2``. A planar scan is what a robot cuts from its 3D scan:
the nearest point in each degree, within the grid's heights above ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from segloc.tools.export import nav2

from .scan_context import ground_below

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BINS_M, BINS_RAD = 0.5, np.radians(10.0)
"""Size of the bins that KLD sampling counts."""

CLUSTER_M, CLUSTER_RAD = 1.0, np.radians(20.0)
"""Reach of a cluster from its mean."""


@dataclass(frozen=True)
class Settings:
    """Parameters of the filter; those of Nav2's AMCL, but for recovery, which is off there.

    Attributes
    ----------
    least, most : int
        Number of particles.
    beams : int
        Of a scan, evenly spaced.
    hit_m : float
        Standard deviation of a beam's end from an obstacle.
    hit, noise : float
        Weights of the likelihood field and of beams that end anywhere.
    reach_m : float
        Largest distance to an obstacle that counts; beams no longer than ``longest_m`` are used.
    kld_error, kld_z : float
        Largest error of the distribution, and the quantile of its probability.
    slow, fast : float
        Rates of the averages of the likelihood whose ratio calls for random poses.
    turn, turn_per_m, drift, drift_m : float
        Standard deviations of a step of odometry: of its turn, by the turn and by the distance; of
        its distance, by the distance, and the least one [m].
    """

    least: int = 500
    most: int = 5000
    beams: int = 60
    hit_m: float = 0.2
    hit: float = 0.5
    noise: float = 0.5
    reach_m: float = 2.0
    longest_m: float = 100.0
    kld_error: float = 0.05
    kld_z: float = 2.326
    slow: float = 0.001
    fast: float = 0.1
    turn: float = 0.1
    turn_per_m: float = 0.02
    drift: float = 0.05
    drift_m: float = 0.02


@dataclass(frozen=True)
class Grid:
    """Distances to the nearest obstacle, and where the robot may be.

    Attributes
    ----------
    distance : (rows, columns) float32
        Metres; rows rise with y.
    free : (F, 2) int32
        Rows and columns of free cells.
    corner : (2,) float64
        x and y of the lower left corner.
    edge_m : float
    """

    distance: NDArray[np.float32]
    free: NDArray[np.int32]
    corner: Floats
    edge_m: float

    @classmethod
    def load(cls, path: Path, reach_m: float) -> Grid:
        """Read ``map.yaml`` and its image, as ``segloc export`` writes them."""
        lines = (line.split(": ", 1) for line in path.read_text("utf-8").splitlines())
        entries = dict(line for line in lines if len(line) == 2)
        edge = float(entries["resolution"])
        x, y, _ = (float(each) for each in entries["origin"].strip("[]").split(","))
        magic, shape, _, pixels = (path.parent / entries["image"]).read_bytes().split(b"\n", 3)
        assert magic == b"P5"
        width, height = map(int, shape.split())
        cells = np.frombuffer(pixels, np.uint8).reshape(height, width)[::-1]
        distance = distance_transform_edt(cells != nav2.OCCUPIED, edge)
        distance = np.minimum(distance, reach_m).astype(np.float32)
        free = np.argwhere(cells == nav2.FREE).astype(np.int32)
        return cls(distance, free, np.array([x, y]), edge)

    @property
    def nbytes(self) -> int:
        """Size of the grid as a byte a cell."""
        return self.distance.size

    def at(self, xy: Floats, reach_m: float) -> Floats:
        """Return the distance of points to the nearest obstacle; beyond the grid, the reach."""
        cells = np.floor((xy - self.corner) / self.edge_m).astype(np.int64)
        columns, rows = cells[..., 0], cells[..., 1]
        inside = (rows >= 0) & (columns >= 0)
        inside &= (rows < self.distance.shape[0]) & (columns < self.distance.shape[1])
        found = np.full(rows.shape, reach_m)
        found[inside] = self.distance[rows[inside], columns[inside]]
        return found

    def random(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw poses on free cells, (count, 3)."""
        chosen = self.free[rng.integers(len(self.free), size=count)][:, ::-1]
        xy = self.corner + self.edge_m * (chosen + rng.uniform(size=(count, 2)))
        return np.column_stack([xy, rng.uniform(-np.pi, np.pi, count)])


def planar(points: NDArray[np.floating], options: nav2.GridOptions, longest_m: float) -> Floats:
    """Return the nearest point in each degree of a level cloud, within the grid's heights, (B, 2).

    Heights are above the ground below the sensor.
    """
    height = points[:, 2] - ground_below(np.asarray(points, dtype=np.float32))
    xy = np.asarray(points[:, :2], dtype=np.float64)
    away = np.hypot(*xy.T)
    chosen = (height >= options.low_m) & (height <= options.high_m) & (away < longest_m)
    xy, away = xy[chosen], away[chosen]
    degree = np.floor(np.degrees(np.arctan2(xy[:, 1], xy[:, 0]))).astype(np.int64)
    order = np.lexsort((away, degree))
    first = np.unique(degree[order], return_index=True)[1]
    nearest: Floats = xy[order[first]]
    return nearest


class ParticleFilter:
    """A robot's belief as particles: x, y and heading in the frame of the grid."""

    def __init__(self, grid: Grid, settings: Settings, seed: int) -> None:
        self.grid, self.settings = grid, settings
        self._rng = np.random.default_rng(seed)
        self.particles = grid.random(settings.most, self._rng)
        self._slow = self._fast = 0.0

    def start(self, pose: tuple[float, float, float], off_m: float, off_rad: float) -> None:
        """Draw the particles around a pose that is given, as by an operator's click."""
        spread = np.array([off_m, off_m, off_rad])
        self.particles = self._rng.normal(pose, spread, (self.settings.most, 3))

    def update(self, step: tuple[float, float, float], beams: Floats) -> None:
        """Move the particles by a step of the odometry, and draw them anew by a planar scan."""
        self._move(*step)
        weights = self._weigh(beams[:: max(1, len(beams) // self.settings.beams)])
        average = float(weights.mean())
        self._slow += self.settings.slow * (average - self._slow) if self._slow else average
        self._fast += self.settings.fast * (average - self._fast) if self._fast else average
        share = max(0.0, 1.0 - self._fast / self._slow)
        self._draw(weights / weights.sum(), share)

    def _move(self, x: float, y: float, turn: float) -> None:
        s, rng = self.settings, self._rng
        count, length = len(self.particles), float(np.hypot(x, y))
        bearing = float(np.arctan2(y, x)) if length else 0.0
        off = rng.normal(0.0, s.turn * abs(turn) + s.turn_per_m * length, (2, count))
        far = rng.normal(length, s.drift * length + s.drift_m, count)
        ahead = self.particles[:, 2] + bearing + off[0]
        self.particles[:, 0] += far * np.cos(ahead)
        self.particles[:, 1] += far * np.sin(ahead)
        self.particles[:, 2] += turn + off[1]

    def _weigh(self, beams: Floats) -> Floats:
        s, (x, y, yaw) = self.settings, self.particles.T
        c, sine = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        ends = np.stack(
            [
                x[:, None] + c * beams[:, 0] - sine * beams[:, 1],
                y[:, None] + sine * beams[:, 0] + c * beams[:, 1],
            ],
            axis=-1,
        )
        off = self.grid.at(ends, s.reach_m)
        likely = s.hit * np.exp(-0.5 * (off / s.hit_m) ** 2) + s.noise / s.longest_m
        weights: Floats = 1.0 + (likely**3).sum(axis=1)
        return weights

    def _draw(self, weights: Floats, random_share: float) -> None:
        """Draw particles by their weights, and a share at random, as many as KLD sampling needs."""
        s, rng = self.settings, self._rng
        drawn = self.particles[rng.choice(len(weights), s.most, p=weights)]
        strays = rng.uniform(size=s.most) < random_share
        drawn[strays] = self.grid.random(int(strays.sum()), rng)
        bins = np.floor(drawn / (BINS_M, BINS_M, BINS_RAD)).astype(np.int64)
        bins[:, 2] %= round(2 * np.pi / BINS_RAD)
        fresh = np.zeros(s.most, dtype=bool)
        fresh[np.unique(bins, axis=0, return_index=True)[1]] = True
        enough = np.arange(1, s.most + 1) >= np.maximum(s.least, needed(np.cumsum(fresh), s))
        self.particles = drawn[: int(enough.argmax()) + 1 if enough.any() else s.most]

    def estimate(self) -> tuple[tuple[float, float, float], float]:
        """Return the mean of the heaviest cluster, and the share of particles in it."""
        bins = np.floor(self.particles / (CLUSTER_M, CLUSTER_M, CLUSTER_RAD)).astype(np.int64)
        bins[:, 2] %= round(2 * np.pi / CLUSTER_RAD)
        _, which, counts = np.unique(bins, axis=0, return_inverse=True, return_counts=True)
        inside = which.reshape(-1) == counts.argmax()
        for _ in range(3):
            x, y = self.particles[inside, :2].mean(axis=0).tolist()
            yaw = float(np.angle(np.exp(1j * self.particles[inside, 2]).sum()))
            away = np.hypot(*(self.particles[:, :2] - (x, y)).T)
            turned = np.angle(np.exp(1j * (self.particles[:, 2] - yaw)))
            inside = (away < CLUSTER_M) & (np.abs(turned) < CLUSTER_RAD)
        return (x, y, yaw), float(inside.mean())


def needed(bins: Ints, settings: Settings) -> Floats:
    """Return how many particles KLD sampling needs if they lie in this many bins."""
    k = np.maximum(bins - 1, 1).astype(np.float64)
    b = 2.0 / (9.0 * k)
    found: Floats = k / (2 * settings.kld_error) * (1 - b + np.sqrt(b) * settings.kld_z) ** 3
    return np.where(bins > 1, found, 1.0)
