"""Tree stems as landmarks: a real forest, each frame against the map of the frames before it.

    python -m segloc_experiments.protocols.trees DATA --out trees.json

DATA is a folder with ``trees.npz`` (rows of base, axis, diameter; offsets of the frames) and
``poses.tum``. A query is one frame. Its map is made of all frames that lie more than 50 m of path
behind it. It is a revisit where one of them was taken within 3 m. With ``--keep 0.5 --noise 0.1``
half of the map's landmarks and half of the query's are taken away, independently, and what is left
is moved at random by so many metres along each axis.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from segloc import geometry
from segloc.batch.score import pose_errors
from segloc.files import write_text
from segloc.landmarks import LandmarkLocalizer, LandmarkMap, LandmarkMapper, Landmarks
from segloc.types import Float64, Int64

from ..intervals import wilson
from ..script import head, parser, row

BEHIND_M = 50.0
REVISIT_M = 3.0
RIGHT_M, RIGHT_DEG = 2.0, 5.0
FAR_M = 3.0
"""Poses of two passes agree only roughly: what is wrong by more is wrong beyond doubt."""


@dataclass(frozen=True)
class Forest:
    """Detections of N frames, and where they were made.

    Attributes
    ----------
    frames : list of Landmarks
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
        lines = np.loadtxt(folder / "poses.tum")
        turns = Rotation.from_quat(lines[:, 4:]).as_matrix()
        poses = np.array([geometry.rigid(R, t) for R, t in zip(turns, lines[:, 1:4], strict=True)])
        path = geometry.travelled(poses)
        behind = np.searchsorted(path, path - BEHIND_M)
        gaps = np.full(len(poses), np.inf)
        for k, count in enumerate(behind):
            if count:
                steps = poses[:count, :3, 3] - poses[k, :3, 3]
                gaps[k] = np.linalg.norm(steps, axis=1).min()
        return cls(frames, poses, behind, gaps)

    def queries(self, every: int) -> Iterator[tuple[int, LandmarkMap]]:
        """Numbers of frames that have any behind them, with the map of those."""
        mapper, added = LandmarkMapper(), 0
        for k in np.flatnonzero(self.behind)[::every]:
            for i in range(added, self.behind[k]):
                mapper.add(self.frames[i], self.poses[i])
            added = int(self.behind[k])
            yield int(k), mapper.map()


@dataclass(frozen=True)
class Thinning:
    """Which share of the landmarks is kept, and by how much each is moved along each axis.

    Map and query are thinned independently, and anew for each query.
    """

    keep: float = 1.0
    noise_m: float = 0.0
    seed: int = 0

    def query(self, landmarks: Landmarks, number: int) -> Landmarks:
        """What is left of a query's landmarks."""
        kept, noise = self._drawn(len(landmarks), (self.seed, 0, number))
        assert landmarks.diameters is not None
        positions = (landmarks.positions + noise)[kept]
        return Landmarks(positions, landmarks.directions[kept], landmarks.diameters[kept])

    def map(self, prior_map: LandmarkMap, number: int) -> LandmarkMap:
        """What is left of a map for one query."""
        kept, noise = self._drawn(len(prior_map), (self.seed, 1, number))
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
