"""Queries localized by each method, correctly and falsely (Table II of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from segloc import geometry
from segloc.errors import DatasetError
from segloc.tools.batch import query_positions
from segloc.tools.datasets import Recording
from segloc.types import Float64

from ... import kitti00
from ...evaluation.comparison_study import compare
from ...evaluation.scenario import MAX_GAP_M, OpenedScenario, QuerySet, Scenario, digest_of_files
from ...evaluation.study import Study
from ...simulation.suites import SIX, TestSet
from ...swathes import Swathes
from . import published
from .workspace import Workspace

EVERY_M = {"small": 40.0, "full": 10.0}
"""Distance between queries by scale [m]; "paper" has as many queries as the paper."""
_NEGATIVE_SEED = 10_000


@dataclass(frozen=True)
class SuiteScenario:
    """A simulated test set; the negative is a world of another seed by the same rules."""

    test: TestSet
    scale: str
    seed: int

    segments_alone = True  # occupancy would find what a method loses

    @property
    def name(self) -> str:
        return self.test.name

    def facts(self) -> tuple[str, str]:
        return self.test.kind, self.test.sensor

    def settings(self) -> dict[str, Any]:
        every_m = self.test.every_m(self.scale) or EVERY_M[self.scale]
        own = {"set": asdict(self.test), "scale": self.scale, "seed": self.seed}
        return {**own, "every_m": every_m}

    def open(self) -> OpenedScenario:
        sessions = self.test.sessions(self.scale, seed=self.seed)
        published_m = self.test.every_m(self.scale)
        query_sets = {
            name: _spread(item, EVERY_M[self.scale])
            if published_m is None
            else _published(item, published_m)
            for name, item in sessions.items()
            if name != "map"
        }
        return OpenedScenario(sessions["map"], self.negative, query_sets)

    def negative(self) -> Recording:
        """Return the drive of the other world's map."""
        length_m = self.test.length_m / len(self.test.tests)
        alone = replace(self.test, tests=self.test.tests[:1], length_m=length_m)
        return alone.sessions(self.scale, seed=self.seed + _NEGATIVE_SEED)["map"]


def _published(recording: Recording, every_m: float) -> QuerySet:
    """Select as many queries of a session as the paper has."""
    truth = _truth(recording)
    positions = geometry.stations(geometry.distance_travelled(truth), every_m, 0.5 * every_m)
    return QuerySet(recording, positions, truth[positions])


def _spread(recording: Recording, every_m: float) -> QuerySet:
    """Return the queries of a session, each with a stretch before it."""
    truth = _truth(recording)
    if isinstance(recording, Swathes):  # they lie 30 m apart: each is a query by itself
        positions = np.arange(len(recording), dtype=np.int64)
    else:
        positions = query_positions(truth, every_m, MAX_GAP_M)
    return QuerySet(recording, positions, truth[positions])


def _truth(recording: Recording) -> Float64:
    return np.asarray(getattr(recording, "truth", recording.poses))


@dataclass(frozen=True)
class KittiScenario:
    """KITTI odometry 00, as keyframes and as full scans with TUM poses.

    "kitti00": the first half of the drive is mapped, and queries are all of the rest every 10 m,
    accumulated, and as one thinned keyframe each (sparse). "kitti00-later": the later passes are
    mapped, and every full scan of the first 827 m is a query by itself. The negative is the
    simulated town of the test set that has the same sensor.
    """

    data: Path
    later: bool
    scale: str
    seed: int

    segments_alone = True

    @property
    def name(self) -> str:
        return "kitti00-later" if self.later else "kitti00"

    def facts(self) -> tuple[str, str]:
        return "Urban, real", "hdl64e"

    def settings(self) -> dict[str, Any]:
        folders = [self.data, self.data / "keyframes", self.data / "scans"]
        for folder in folders:
            if not folder.is_dir():
                raise DatasetError(f"{folder}: no such folder; --kitti needs keyframes and scans")
        files = digest_of_files(self.data)
        return {"scenario": self.name, "files": files, "scale": self.scale, "seed": self.seed}

    def open(self) -> OpenedScenario:
        town = next(test for test in SIX if test.name == "kitti")
        negative = SuiteScenario(town, self.scale, self.seed).negative
        names = ("single",) if self.later else ("accumulated", "sparse")
        query_sets = {name: kitti00.query_set(self.data, name) for name in names}
        return OpenedScenario(kitti00.mapped(self.data, names[0]), negative, query_sets)


def scenarios(workspace: Workspace) -> Sequence[Scenario]:
    """Return the test sets of the suite, and KITTI if available."""
    scale, seed = workspace.scale, workspace.seed
    chosen: list[Scenario] = [SuiteScenario(test, scale, seed) for test in workspace.sets]
    if workspace.data is not None:
        chosen += [KittiScenario(workspace.data, later, scale, seed) for later in (False, True)]
    return chosen


def run(workspace: Workspace) -> Study:
    """Localize the queries of all scenarios of a workspace; see :func:`scenarios`."""
    found = scenarios(workspace)
    return compare(workspace, found, "localization", "Localization", [published.localizations()])
