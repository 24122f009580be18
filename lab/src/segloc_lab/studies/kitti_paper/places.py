"""Which part of the drive is mapped, which is localized, and where K is chosen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from segloc import geometry
from segloc.batch.run import query_positions
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path
from segloc.datasets import Sequence
from segloc.types import Float64, Int64

from ...evaluation.scenario import MAX_GAP_M
from ...kitti00 import keyframes, poses_of

LAST_M, EVERY_M = 1300.0, 9.7
"""What is localized, and how often: 133 clouds (the paper has 134)."""

TRAINING_FROM = 561
"""First keyframe of the part that is localized to choose K; earlier ones are mapped for that."""


@dataclass(frozen=True)
class Part:
    """A map, and queries that none of its scans is among.

    Attributes
    ----------
    mapped, queried : Sequence
    positions : (N,) int64
        Of the queries in ``queried``.
    distances : (N,) float64
        Of each query to the mapped path, metres.
    """

    mapped: Sequence
    queried: Sequence
    positions: Int64
    distances: Float64

    def between(self, first: int, stop: int) -> Part:
        """The same part with some of its queries."""
        some = slice(first, stop)
        return replace(self, positions=self.positions[some], distances=self.distances[some])

    @property
    def truths(self) -> Float64:
        """True poses of the queries, (N, 4, 4)."""
        return poses_of(self.queried)[self.positions]


def _split(data: Path, first: int) -> tuple[Sequence, Sequence]:
    return keyframes(data, f":{first - 1}"), keyframes(data, f"{first}:")


def first_query(data: Path) -> int:
    """The keyframe at which the last 1300 m begin."""
    drive = keyframes(data)
    way = geometry.travelled(poses_of(drive))
    return int(drive.indices[np.searchsorted(way, way[-1] - LAST_M)])


def test_part(data: Path) -> Part:
    """The last 1300 m, a query every 9.7 m, in the map of everything before."""
    mapped, queried = _split(data, first_query(data))
    positions = query_positions(poses_of(queried), EVERY_M, MAX_GAP_M)
    return _part(mapped, queried, positions)


def training_part(data: Path) -> Part:
    """Places of the test's map alone: every keyframe near an earlier one, elsewhere every 19.4 m.

    What lies beyond the map's places are the negatives by which thresholds are set. (A mirror image
    of the map is none here: an estimator in SE(3) finds it, upside down.)
    """
    last = first_query(data) - 1
    mapped = keyframes(data, f":{TRAINING_FROM - 1}")
    queried = keyframes(data, f"{TRAINING_FROM}:{last}")
    near = distances_to_path(poses_of(queried), poses_of(mapped)) <= COVERAGE_RADIUS_M
    spread = query_positions(poses_of(queried), 2 * EVERY_M, MAX_GAP_M)
    return _part(mapped, queried, np.union1d(np.flatnonzero(near), spread))


PARTS = {"test": test_part, "training": training_part}


def _part(mapped: Sequence, queried: Sequence, positions: Int64) -> Part:
    distances = distances_to_path(poses_of(queried)[positions], poses_of(mapped))
    return Part(mapped, queried, positions, distances)
